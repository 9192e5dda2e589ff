"""What is known beforehand: priors of base and joints, point pairs of an outside matcher."""
