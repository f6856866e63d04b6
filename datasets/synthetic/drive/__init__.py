"""A driving log of a synthetic street: the car with its cameras and LiDAR, and how it is written."""
