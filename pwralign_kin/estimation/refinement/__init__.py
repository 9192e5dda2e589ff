"""Base and joints together to the last bit that the points hold: least squares and greatest likelihood."""
