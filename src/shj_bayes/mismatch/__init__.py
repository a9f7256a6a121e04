"""Where model and recording part: locate, name, model, show."""
