"""Other ways to align, for comparison only."""
