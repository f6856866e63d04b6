"""Where scene and initial points come from, by the kind of scene (datasets/kinds.py), in the units of the files.

photographs.py   poses from the files, random points or those of the files
videos.py        cameras that stand still: points triangulated from the first frames, with or without known poses
clips.py         cameras that move: poses and points of all frames in use
drive.py         driving logs: points of LiDAR, else triangulated along the way
reconstruct.py   what they share: structure from motion, through its cache, and what follows from its points
"""
