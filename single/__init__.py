"""One camera, one image: corners in; focal, pose and covariance out. Pure functions on arrays."""
