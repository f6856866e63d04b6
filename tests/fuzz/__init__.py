"""Fuzzing: odd files for every reader and odd arguments for `rasterize`, and a search for one that breaks a rule.

    target.py      what a target is: a valid example, how it is changed, and the rule that must hold whatever came of it
    read_*.py      a target for each reader; render.py that of `rasterize`;  targets.py lists them
    edits.py       changes to bytes and texts;  edit_json.py, edit_arrays.py to what has structure
    search.py      Hypothesis makes cases of a target until its time is up, and shrinks what breaks the rule
    supervise.py   the search in a process of its own, so that a crash or a hang is a finding too
    found/         inputs that once broke a rule, each with a name; the tests replay them

`python -m fuzz` lists the targets. The rule for a reader: any bytes give a valid result, or one line of the project's
own that names the file, what was expected and what was found; never another exception, a crash, a hang or a warning.

Why a folder of its own and not tests/: the command is for hours, and must be there without pytest; the tests run a few
cases of each target (tests/fuzz/test_fuzz.py). Why Hypothesis: cases must be almost valid to get beyond the first check,
which changes to a valid example are; it shrinks what it finds and repeats itself for a seed. A coverage-guided engine
would see the readers' Python but none of the libraries that decode (Pillow, FFmpeg, safetensors, the kernel).
"""
