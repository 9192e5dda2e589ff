"""How sure each joint is, and which ones the scan does not tell."""
