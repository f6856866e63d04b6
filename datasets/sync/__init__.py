"""When cameras that were not synchronised started: offsets and drifts of their clocks, from sound or from the picture.

signals.py     what is compared: log energy of the sound, brightness and motion energy of the picture
correlate.py   the lag of two signals, and how sure it is
offsets.py     all pairs → one offset (and drift) for each camera, by least squares
"""
