"""Studies beyond the metrics of a single run: `python -m pipeline.studies.NAME [RUN …] [--out DIR]`.

| NAME              | question                                                                | input           |
|:------------------|:------------------------------------------------------------------------|:----------------|
| compression       | How small does a trained model get, and what does it cost in PSNR?      | RUN             |
| overfitting       | How far do training and held-out views differ, and which Gaussians do?  | RUN [RUN …]     |
| video_length      | How many Gaussians does a longer video need?                            | RUNS, a folder  |
| gradient_clipping | Does gradient clipping improve training?                                | none: trains    |
| cost_scaling      | How does time grow with Gaussians, pixels, batch and video length?      | none: generated |
| kernel_precision  | What does each numerical choice of the kernel cost in accuracy or time? | none, or a RUN  |
| kernel_stability  | Does the float32 kernel stay accurate on ill-conditioned scenes?        | none: generated |

Output goes to results/NAME/ unless --out names another folder: NAME.md (the table; overfitting prints it instead),
NAME.svg (the plot; none of gradient_clipping and kernel_stability), NAME.csv (of the last five but gradient_clipping).
Besides: compression/compression.safetensors, overfitting/moment.webp, kernel_stability/instruction_sets.csv.
A wrong option is one line and exit status 2; input that cannot be used is one line and exit status 1.
"""
