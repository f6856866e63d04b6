"""Structure from motion: where points of a scene lie, and where cameras stand, from photographs of one moment.

    photograph.py   what goes in and comes out
    run.py          reconstruct(): writes the photographs, runs COLMAP in a process of its own, reads what it found
    colmap.py       that process: features, matches, triangulation or mapping, filtering;  register.py  held-out cameras
    job.py          the files between the two
    store.py        keeps a result until its inputs change;  picture.py  cameras and points, drawn

`python -m pipeline.data.sfm FOLDER` runs it on a folder of photographs.
"""
