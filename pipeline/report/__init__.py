"""From a folder of finished runs to tables, plots and one HTML page.

Data flows one way, a module a step:

    collect     run folders        -> tidy frames (broken and unfinished runs named and left out)
    variants    runs               -> runs whose settings differ under one name get names of their own
    aggregate   frames             -> mean ± std over seeds, standard errors, ablation verdicts
    paper       results/paper/     -> the paper's numbers, as printed
    tables      both               -> the paper's tables with our rows beside (run_tables: our own)
    structure   runs               -> what COLMAP found of each scene
    comparisons, bands             -> which curves stand in one figure; mean and spread of each
    plots, strips                  -> curves (SVG) and render | truth | difference images (WebP)
    export, page                   -> Markdown, CSV, LaTeX; one self-contained HTML page

The report reads run folders only. It trains nothing and edits nothing that a run wrote.
"""
