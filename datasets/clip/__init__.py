"""Clips by cameras that move, without poses: a video file, a folder of images in order, or several videos.

survey.py     one pass in small: sharpness, motion, brightness, cuts, bars; whether the camera stands still
choose.py     the part of a clip and the frames that are used
footage.py    the clip of one camera: all of these, and its frames
clips.py      open_clip(), open_clips(): one camera, several on one clock; to_scene() once their poses are known
"""
