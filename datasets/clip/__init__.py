"""Reader of one clip by a camera that moves, without poses: a video file, or a folder of images in order.

survey.py     one pass in small: sharpness, motion, brightness, cuts, bars
choose.py     the part of the clip and the frames that are used
footage.py    open_clip(): all of these; Clip.to_scene() once structure from motion has found the cameras
"""

from datasets.clip.footage import Clip, ClipFrame, ClipOptions, is_clip, open_clip

__all__ = ["Clip", "ClipFrame", "ClipOptions", "is_clip", "open_clip"]
