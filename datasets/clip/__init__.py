"""Clips by cameras that move, without poses: a video file, a folder of images in order, or several videos.

survey.py     one pass in small: sharpness, motion, brightness, cuts, bars
choose.py     the part of the clip and the frames that are used
footage.py    open_clip(): all of these; Clip.to_scene() once structure from motion has found the cameras
scene.py      scene_of_views(): the scene of frames with cameras
still.py      whether the camera of a video stands still
several.py    open_clip_set(): several cameras, of which some move, on one clock
"""
