"""File input and output shared by all readers: atomic writes, error classes, JSON values, images, decoded frames."""
