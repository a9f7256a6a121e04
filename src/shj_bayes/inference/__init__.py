"""What the data say: the posterior of one device, from problem to stored result."""
