"""Configurations compared with the scan, which every later stage does."""
