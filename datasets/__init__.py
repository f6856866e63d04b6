"""Data sets: one reader per layout on disk. Opened it is a `Source`, which gives a `Scene`.

settings.py   the settings `scene.*`                  scene.py   Scene, View: what every reader returns
source.py     opens the data that the settings name   readers/   a module a layout

Nothing is imported here: settings and errors are for the command line, which starts without torch.
"""
