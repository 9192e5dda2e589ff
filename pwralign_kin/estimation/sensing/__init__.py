"""The scan as the estimator sees it: points at their scales, surroundings, free space, silhouettes."""
