"""Video files as people have them, read with PyAV (FFmpeg): headers, frames with their times, high dynamic range.

probe.py      the header: size, rotation, rate, colours; what is refused before a frame is decoded
decode.py     frames with their times, upright, in 8-bit colour (hdr.py maps high dynamic range to it)
"""
