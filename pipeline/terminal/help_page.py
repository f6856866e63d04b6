"""What `python -m pipeline --help` prints: what the command does, what can be chosen, examples, where to read on."""

from __future__ import annotations

import textwrap

from pipeline.config.compose import options

WIDTH = 110

# Group of conf/ -> what it chooses, and its default.
GROUPS = {
    "scene": ("the data; must be given", None),
    "train": ("the schedule", "paper"),
    "ablation": ("which part of the model is left out", "full"),
    "launcher": ("where the runs of a sweep are run", "local"),
    "experiment": ("a sweep of runs by name", None),
}

# Each is composed by a test.
EXAMPLES = (
    ("scene=synthetic/wheel train=fast", "a synthetic scene, made first"),
    ("scene=synthetic/wheel train=smoke", "every step once, in seconds; its numbers mean nothing"),
    ("scene=dnerf scene.path=DIR train=fast", "any folder in the D-NeRF layout, or with a transforms.json"),
    ("scene=dnerf scene.path=DIR scene.validation_every=8", "… without a test split: every eighth view is held out"),
    ("scene=dnerf/lego scene.path=DIR train=release", "a D-NeRF scene as the authors' released program trains it"),
    ("scene=plenoptic scene.path=DIR train=fast", "videos of several cameras with poses_bounds.npy"),
    ("scene=video scene.path=CLIP.mp4", "your own clip, by a camera that moves; or DIR: videos of several cameras"),
    ("scene=video scene.path=DIR estimate=true", "only estimates time, memory and disk"),
    ("scene=auto scene.path=DIR", "a folder of COLMAP, nerfstudio and others"),
    ("scene=kitti scene.path=DIR train=fast", "a driving log with LiDAR; scene=waymo likewise"),
    ("-m scene=synthetic/lamp ablation=full,no_4dsh seed=0,1,2", "a sweep: six runs; launcher=joblib: side by side"),
    ("scene=synthetic/wheel train.iterations=10000 out=DIR", "single keys, and a run folder of your own"),
    ("scene=synthetic/lamp view=true", "shows the model in a browser while it is trained"),
    ("experiment=reproduce", "the sweep of `make reproduce`"),
)


def help_page() -> str:
    """The page, plain text of at most WIDTH columns."""
    parts = [
        "4D Gaussian Splatting on a CPU: trains a model of a dynamic scene from its images and evaluates it.",
        "Usage\n"
        "  python -m pipeline scene=CHOICE [GROUP=CHOICE …] [KEY=VALUE …]     one run\n"
        "  python -m pipeline -m KEY=VALUE,VALUE …                            a run for each combination",
        textwrap.fill(
            "A run reads the scene, initialises Gaussians (from COLMAP's points where several cameras filmed), trains "
            "them, and evaluates them on the held-out views. It writes metrics.json, pictures and the model to "
            "results/runs/<scene>/<ablation>/<train>/seed<k>. After an interruption the same command continues "
            "the run.",
            WIDTH,
        ),
        "Groups and their choices (conf/GROUP/CHOICE.yaml)\n" + "\n".join(map(_group, GROUPS)),
        "Examples\n" + "\n".join(_example(*example) for example in EXAMPLES),
        "Keys\n"
        "  datasets/settings.py              every key of scene: default, meaning, range\n"
        "  pipeline/config/schema.py         every key of init, ablation, evaluate and of the run itself\n"
        "  pipeline/config/train_schema.py   every key of train\n"
        "  --list                     behind a command: prints the command of each run, for batch systems; runs none\n"
        "  --cfg job                  behind a command: prints the configuration it would run with\n"
        '  A path may hold any character; the shell wants its own quotes: "scene.path=/my data/jug".',
        "Then\n"
        "  python -m pipeline.report results/runs    tables, plots and a page of pictures of all runs\n"
        "  python -m pipeline.view RUN [RUN …]       a page that plays a run, or several side by side, in a browser\n"
        "  --version                                 the version, and the commit of the checkout",
    ]
    return "\n\n".join(parts) + "\n"


def _group(name: str) -> str:
    meaning, default = GROUPS[name]
    heading = f"  {name}: {meaning}" + (f" (default: {default})" if default else "")
    choices = textwrap.fill(
        ", ".join(options(name)),
        WIDTH,
        initial_indent="      ",
        subsequent_indent="      ",
        break_on_hyphens=False,
        break_long_words=False,
    )
    return f"{heading}\n{choices}"


def _example(arguments: str, meaning: str) -> str:
    return f"  python -m pipeline {arguments}\n      {meaning}"
