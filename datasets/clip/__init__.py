"""Clips by cameras that move, without poses: a video file, a folder of images in order, or several videos.

survey.py     one pass in small: sharpness, motion, brightness, cuts, bars; whether the camera stands still
choose.py     the part of the clip and the frames that are used
footage.py    open_clip(): all of these; Clip.to_scene() once structure from motion has found the cameras
several.py    open_clip_set(): several cameras, of which some move, on one clock
"""
