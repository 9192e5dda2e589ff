"""Configurations that could explain the scan: hypotheses grown through the tree, repaired, read another way."""
