"""The report's files: pages, plots, strips of pictures, and the folder they go into."""
