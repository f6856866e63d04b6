"""Builds a report from a folder of finished runs: tables, plots, image strips, one HTML page.

    read     the paper's numbers, its scenes and ablations, its evaluation split
    compare  learning curves grouped into figures and averaged over seeds
    tables   the paper's tables with our results, and tables of our own results
    write    plots, image strips, report.md, report.html, files

build.py puts these together. The report only reads run folders; it does not train and does not change them.
"""
