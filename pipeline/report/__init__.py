"""From a folder of finished runs to tables, plots and one HTML page.

Data flows one way, a module a step:

    collect             run folders        -> tidy frames (broken and unfinished runs named and left out)
    variants, models    runs               -> names that differ where settings or trained models do (names: their form)
    measured_on         runs               -> those that may stand in the paper's tables
    aggregate           frames             -> mean ± std over seeds, standard errors, ablation verdicts
    paper               results/paper/     -> the paper's numbers, as printed
    tables              both               -> the paper's tables with our rows beside (run_tables: our own)
    structure           runs               -> what COLMAP found of each scene
    comparisons, bands                     -> which curves stand in one figure; mean and spread of each
    plots, strips                          -> curves (SVG) and render | truth | difference images (WebP)
    content             all of it          -> reading order, report.md, what is printed
    layout, export, page                   -> tables that fit; Markdown, CSV, LaTeX; one self-contained HTML page
    out_folder          files              -> written in the place of the report before

The report reads run folders only. It trains nothing and edits nothing that a run wrote.
"""
