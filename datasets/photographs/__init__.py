"""What readers of image files with cameras share: files in any order -> Scene.

photograph.py   an image file with its camera; all of one size
file_names.py   which camera took it, and when, by names
selection.py    which are used, trained on and held out
scene.py        to_scene()
"""
