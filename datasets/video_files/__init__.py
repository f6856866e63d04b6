"""Videos as a player shows them, read with PyAV (FFmpeg): frames and their times; folders of images as clips."""
