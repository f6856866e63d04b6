"""What somebody meets who has never used the command: the help page, paths as they are, folders that are not ours,
interruptions. Commands are run as a user would."""

from __future__ import annotations

import json
import os
import re
import shlex
import subprocess
import sys
import time
from pathlib import Path

import pytest
from hydra import compose, initialize_config_dir
from hydra.core.override_parser.overrides_parser import OverridesParser
from shell import TINY, Shell

from pipeline.config.compose import CONFIG_DIR, known_keys, one_line, options, quote_text, register_schema
from pipeline.runs.run_identity import read_config, refuse_foreign
from pipeline.terminal.help_page import EXAMPLES, GROUPS, WIDTH, help_page
from pipeline.terminal.sweeper import combinations


@pytest.fixture(scope="module")
def shell(tmp_path_factory) -> Shell:
    return Shell(tmp_path_factory.mktemp("first"))


# --- the page -------------------------------------------------------------------------------------------------------


def test_the_page_names_every_choice_and_fits_a_terminal() -> None:
    page = help_page()
    assert max(map(len, page.splitlines())) <= WIDTH
    words = set(re.findall(r"[\w/]+", page))
    for group in GROUPS:
        assert set(options(group)) <= words
    assert set(GROUPS) == {folder.name for folder in CONFIG_DIR.iterdir() if folder.is_dir()} - {"hydra", "capture"}


@pytest.mark.parametrize("arguments", [arguments for arguments, _ in EXAMPLES])
def test_every_example_composes(arguments: str) -> None:
    register_schema()
    overrides = [word for word in shlex.split(arguments) if word != "-m"]
    if not any(word.startswith("scene=") for word in overrides):
        overrides.append("scene=dnerf")  # the sweep names it
    overrides = [word.split(",")[0] if "-m" in arguments else word for word in overrides]
    with initialize_config_dir(str(CONFIG_DIR), version_base="1.3"):
        compose("config", overrides=overrides)


@pytest.mark.parametrize("arguments", [["--help"], ["-h"], ["--cfg", "job"]])
def test_help_is_the_page(shell: Shell, arguments: list[str]) -> None:
    out, err = shell(*arguments)
    assert out.startswith(help_page()) and err == ""


def test_without_a_scene_the_page_and_a_refusal(shell: Shell) -> None:
    out, err = shell(status=1)
    assert out == help_page() and err.startswith("error: scene: must be given; there are ") and err.count("\n") == 1


def test_a_typo_need_not_wait_for_torch() -> None:
    code = "import sys, pipeline.cli; sys.exit(bool({'torch', 'cv2', 'pycolmap'} & set(sys.modules)))"
    assert subprocess.run([sys.executable, "-c", code], cwd=CONFIG_DIR.parent).returncode == 0


def test_the_version(shell: Shell) -> None:
    out, _ = shell("--version")
    assert re.fullmatch(
        r"gaussians-4d (\d+\.\d+\.\d+|\(not installed\)), commit ([0-9a-f]{40}(-dirty)?|unknown)\n", out
    )


# --- paths ----------------------------------------------------------------------------------------------------------

PATHS = [
    "/my data/jug",
    "/Küche/日本",
    "~/jug",
    "/a (1)/b",
    "/a=b",
    "/it's",
    '/say "x"',
    "/a#b;c&d",
    "/a[1]{2}",
    "C:\\x\\",
    "2024_11_28",  # the rest are numbers, lists and others to Hydra
    "1e3",
    "true",
    "a,b",
    "a\\,b",
    "[a]",
    " a ",
    "choice(a,b)",
]


def value_of(argument: str) -> object:
    return OverridesParser.create().parse_override(argument).value()


@pytest.mark.parametrize("key", ["scene.path", "out", "scene.name", "++train.name"])
@pytest.mark.parametrize("path", PATHS)
def test_a_path_reaches_the_configuration_as_it_was_typed(path: str, key: str) -> None:
    (argument,) = quote_text([f"{key}={path}"])
    assert value_of(argument) == path


def test_what_can_be_read_stays() -> None:
    typed = ["scene.path=/plain/path", "scene.path='quoted ü'", "scene=dnerf", "train.iterations=[1", "-m", "out="]
    typed += ["train.iterations=1_000", "scene.path=null", "out=${scene.name}/2"]
    assert quote_text(typed) == typed


def test_paths_of_a_sweep_are_as_typed_too(tmp_path: Path) -> None:
    (argument,) = quote_text(["scene.path=2024_11_28, my data,'a,b',1e3"], sweep=True)
    assert [value_of(run) for (run,) in combinations([argument])] == ["2024_11_28", "my data", "a,b", "1e3"]
    assert quote_text(["out=choice(a,b)"], sweep=True) == ["out=choice(a,b)"]
    (tmp_path / "a,b").mkdir()
    (argument,) = quote_text([f"scene.path={tmp_path}/a,b"], sweep=True)
    assert value_of(argument) == f"{tmp_path}/a,b", "it is there"


def test_a_run_into_a_folder_named_after_a_day(shell: Shell) -> None:
    shell(*TINY, "out=2024_11_28", "train.name=1e3", "until=init")
    assert (shell.folder / "2024_11_28/init.ply").exists()
    assert read_config(shell.folder / "2024_11_28/config.yaml")["train"]["name"] == "1e3"


def test_a_run_from_and_into_folders_with_odd_names(shell: Shell) -> None:
    shell(*TINY, "train.iterations=20", "out=first run (ü)")
    cached = next((shell.folder / "results/cache").iterdir())
    data = shell.folder / "Küche #1"
    cached.rename(data)
    out, err = shell(
        "scene=dnerf",
        f"scene.path={data}",
        "train=smoke",
        "train.iterations=20",
        "scene.downscale=1",
        "threads=1",
        "evaluate.lpips=false",
    )
    data.rename(cached)
    assert err == "" and "dnerf/Küche #1 · full · smoke · seed 0" in out
    metrics = json.loads((shell.folder / "results/runs/dnerf/Küche #1/full/smoke/seed0/metrics.json").read_text())
    assert metrics["scene"] == "dnerf/Küche #1"
    assert metrics["kind"] == {"motion": "full", "fourier_order": 2, "sh_degree": 3, "trajectories": 0}


# --- folders --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "name, content",
    [
        ("metrics.json", '{"accuracy": 1}'),
        ("config.yaml", "model: resnet\n"),
        ("renders", None),
        ("log.jsonl", "{}\n"),
        ("notes.txt", "precious"),
        (".tmp-notes", "precious"),
    ],
)
def test_files_that_no_run_made_are_left_alone(tmp_path: Path, name: str, content: str | None) -> None:
    folder = tmp_path / "theirs"
    folder.mkdir()
    (folder / name).mkdir() if content is None else (folder / name).write_text(content)
    with pytest.raises(ValueError, match=f"theirs: expected a run folder or an empty one, found {name}, which no run"):
        refuse_foreign(folder)


def test_a_foreign_metrics_file_survives_the_command(shell: Shell) -> None:
    folder = shell.folder / "theirs"
    folder.mkdir()
    (folder / "metrics.json").write_text("{}")
    for resume in ("true", "false"):
        _, err = shell(*TINY, "out=theirs", f"resume={resume}", status=1)
        assert "found metrics.json, which no run of this program made; give another out=DIR" in err
    assert [path.name for path in folder.iterdir()] == ["metrics.json"] and (
        folder / "metrics.json"
    ).read_text() == "{}"


@pytest.mark.parametrize(
    "arguments",
    [
        ["scene=dnerf", "scene.path=nowhere"],
        ["scene=video", "scene.path=nowhere"],
        ["scene=plenoptic", "scene.path=nowhere"],
        [*TINY, "init.source=sfm"],
        [*TINY, "train.batch=1000", "scene.cache=cache"],
    ],
)
def test_refused_input_leaves_no_run_folder(shell: Shell, arguments: list[str]) -> None:
    before = set(shell.folder.rglob("*"))
    _, err = shell(*arguments, "out=refused/deep", status=1)
    assert err.startswith("error: ") and err.count("\n") == 1
    assert not (shell.folder / "refused").exists()
    made = set(shell.folder.rglob("*")) - before
    assert [path for path in made if path.is_file() and "cache" not in path.parts] == []


# --- records --------------------------------------------------------------------------------------------------------


def test_the_configuration_that_is_written_is_the_one_that_is_trained(shell: Shell) -> None:
    command = ("scene=synthetic/still", *TINY[1:], "train=short", "train.iterations=20", "out=still")
    shell(*command)
    text = (shell.folder / "still/config.yaml").read_text()
    assert "static: true" in text and "init_points: 60000" in text  # conf/train/fast/static.yaml
    assert re.search(r"background:\n +- 0.0\n +- 0.0\n +- 0.0\n", text)
    out, _ = shell(*command)
    assert "train: already done" in out and (shell.folder / "still/config.yaml").read_text() == text
    _, err = shell(*command, "train.init_points=50", status=1)
    assert "holds another run, with train.init_points=60000 but this command has 50" in err


# --- interruptions --------------------------------------------------------------------------------------------------


def interrupted(shell: Shell, *arguments: str, after: str) -> str:
    """Standard error of a command that gets a Ctrl-C once it has printed a line that begins with `after`."""
    command = shell.start(*arguments)
    while not any(line.startswith(after) for line in command.said().splitlines()):
        assert command.is_running(), command.wait()
        time.sleep(0.01)
    command.interrupt()
    status, _, err = command.wait()
    assert status == 130 and err.count("\n") == 1, err
    return err


def test_an_interruption_says_what_is_kept(shell: Shell) -> None:
    long = (*TINY, "train.iterations=20000", "train.eval_every=20000", "out=long")
    err = interrupted(shell, *long, "train.checkpoint_every=20000", after="train: ")
    kept = "prepare, settle, init kept, no iteration of training yet"
    assert err == f"error: interrupted; {kept}; the same command goes on from there\n"
    often = (*long, "train.checkpoint_every=5", "resume=false")  # which the same command would start over once more
    err = interrupted(shell, *often, after="1000/")
    assert re.fullmatch(r"error: interrupted; the same command without resume=false goes on from iteration \d+\n", err)


def test_closed_output_is_no_traceback(shell: Shell) -> None:
    process = subprocess.Popen(
        [sys.executable, "-m", "pipeline", *TINY, "train.iterations=100", "out=closed"],
        cwd=shell.folder,
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env={**os.environ, "PYTHONPATH": str(CONFIG_DIR.parent)},
    )
    process.stdout.readline()
    process.stdout.close()
    err = process.stderr.read()
    assert process.wait(timeout=120) == 1 and err.startswith("error: standard output was closed; ")
    assert err.count("\n") == 1


def test_errors_of_the_system_name_the_file(tmp_path: Path) -> None:
    with pytest.raises(OSError) as error:
        (tmp_path / "not there").read_text()
    assert one_line(error.value) == f"{tmp_path}/not there: No such file or directory"


def test_every_key_is_described() -> None:
    """The page says where: in one of two files, each key beside or below a comment; a group of keys is a class."""
    lines = [
        line
        for name in ("datasets/settings.py", "pipeline/config/schema.py", "pipeline/config/train_schema.py")
        for line in (CONFIG_DIR.parent / name).read_text().splitlines()
    ]
    described = {
        match[1]
        for before, line in zip(lines, lines[1:])
        if (match := re.match(r"    (\w+): .+ = ", line))
        and (
            "  # " in line
            or before.startswith("    # ")
            or "default_factory" in line
            and re.search(r": (\w+Config|LearningRates) = ", line)
        )
    }
    assert {key.split(".")[-1] for key in known_keys()} - described == set()
