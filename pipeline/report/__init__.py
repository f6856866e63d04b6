"""Builds a report from a folder of finished runs: tables, plots, image strips, one HTML page.

runs.py reads the runs into a data frame. tables.py lists the tables as data; run_table.py and paper_table.py make them.
curve_figures.py and plots.py draw learning curves, mean_curves.py those of several scenes, strips.py held-out views and
figures. content.py puts all of it into sections, build.py into HTML and files; site.py makes a page for each scene,
with leaderboards (leaderboard.py). The report only reads run folders; it does not train and does not change them.
"""
