"""Studies: questions beyond one run, a folder each: `python -m pipeline.studies.<name> [RUN …] [--out DIR]`.

| name               | question                                             | input          | output             |
|:-------------------|:-----------------------------------------------------|:---------------|:-------------------|
| compression        | How does PSNR fall with the size of a trained model? | RUN            | table, safetensors |
| error_against_time | How good is a recipe after so many CPU seconds?      | RUNS, a folder | table, CSV, plot   |
| training_profile   | Where do the CPU seconds of a training go?           | KEY=VALUE …    | table, CSV         |
| video_length       | How many Gaussians does a longer video need?         | RUNS, a folder | table, CSV         |
| kernel_precision   | What error and time does each numerical choice cost? | RUN, or –      | table, CSV, plot   |
| kernel_stability   | Is the kernel accurate in ill-conditioned scenes?    | –              | table, CSV         |
| reference_points   | What PSNR does a short training reach anywhere?      | –              | table, CSV         |

A study's README.md has its question, its answer and its command. Nothing outside imports a study. Output goes to
results/<name>/, files are called <name>.md, .csv and .svg, and the table is printed too. A wrong option is one line and
exit status 2; input that cannot be used is one line and exit status 1.
"""
