"""Exposure and white balance of several cameras, made equal by the points that they see in common.

matches.py    the colour of each point in each camera
fit.py        a gain and an offset a channel for each camera, robustly
choose.py     which cameras are corrected, by cross-validation, and what the run says of it
"""
