"""Several frames of one scene, with known camera poses, as one observation."""
