"""Structure from motion with COLMAP: points, and camera poses if unknown, from photographs of one moment.

In the process of the run:
    run.py            reconstruct(): starts the COLMAP process and reads its result
    clip.py           reconstruct_clip(): the same for the frames of clips, in two passes
    reconstruction.py the result
    cache.py          keeps a result until its inputs change
    plot.py           plots cameras and points
In the COLMAP process:
    colmap.py         features, matches, triangulation or incremental mapping, filtering
    features.py       settings of pycolmap that mapping and registration share
    registration.py   poses of held-out cameras
Between both:
    job.py            the files of a request and its result

`python -m pipeline.data.sfm FOLDER` runs it on a folder of photographs.
"""
