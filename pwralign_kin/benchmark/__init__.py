"""How well and how fast the estimates are: cases x methods x metrics -> tables."""
