"""What is believed: the law, the noise, the priors, and recordings simulated from them."""
