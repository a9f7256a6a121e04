"""What came from the laboratory, in the order it happens: file -> table -> columns -> checks -> recording -> motion."""
