"""Several scans of one base, and what calibration says of given joint values."""
