"""Video files as people have them, read with PyAV (FFmpeg): headers, frames with their times, high dynamic range."""
