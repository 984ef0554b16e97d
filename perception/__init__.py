"""RGB-D frames and laser logs to clean points, free rays and occluded space."""
