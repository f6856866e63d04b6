"""Between Hydra and the schema: registers it, composes a command's configuration, and turns errors into one line."""

from __future__ import annotations

import difflib
import os
import re
from collections.abc import Iterator, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, field, is_dataclass, replace
from functools import cache, cached_property
from pathlib import Path
from typing import Any, get_type_hints

import hydra
from hydra.core.config_store import ConfigStore
from hydra.core.global_hydra import GlobalHydra
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Override, QuotedString, ValueType
from hydra.errors import HydraException, OverrideParseException
from omegaconf import DictConfig, OmegaConf, open_dict
from omegaconf.errors import OmegaConfBaseException

from datasets.files.errors import clear
from pipeline.config.scaled import ITERATIONS, scaled, scaled_keys
from pipeline.config.schema import Config

CONFIG_DIR = Path(__file__).resolve().parents[2] / "conf"
_PRESET = ("scene", "train", "ablation")  # the choices that make a run's preset


@dataclass(frozen=True)
class Composed:
    """What Hydra made of a command line."""

    tree: DictConfig
    choices: dict[str, str]  # group -> what was chosen of it


@dataclass(frozen=True)
class Command:
    """The overrides of a command line, `key=value`: they compose a configuration for each kind of scene."""

    overrides: tuple[str, ...]
    # By kind of scene: composing takes a quarter of a second, and a run asks several times. Hydra has composed a run's
    # for None, before the kind is known.
    compositions: dict[str | None, Composed] = field(default_factory=dict, repr=False, compare=False, kw_only=True)
    _configs: dict[str | None, Config] = field(default_factory=dict, init=False, repr=False, compare=False)

    def config(self, capture: str | None = None) -> Config:
        """The configuration where the scene is of this kind (conf/capture); None: where that is not known yet. With
        `train.iterations` on the command line the schedule's other iteration numbers are scaled, unless they are given.

        Raises what Hydra, OmegaConf and the schema raise.
        """
        if capture not in self._configs:
            cfg = to_config(self.composed(capture).tree)
            if ITERATIONS in self.given:
                share = cfg.train.iterations / self.preset(capture).train.iterations
                cfg = replace(cfg, train=scaled(cfg.train, cfg.train.iterations, share, self.given))
            self._configs[capture] = cfg
        return self._configs[capture]

    @cached_property
    def given(self) -> frozenset[str]:
        """The dotted keys that the command line sets."""
        found: set[str] = set()
        for override in self.overrides:
            if (read := _read(override)) is not None:
                key = read.key_or_group.lstrip("+")
                value = read.value() if not read.is_sweep_override() else None
                found |= {key} | (set(_keys_of(value, f"{key}.")) if isinstance(value, dict) else set())
        return frozenset(found)

    def scaled_values(self, capture: str | None = None) -> dict[str, tuple[Any, Any]]:
        """Dotted key -> (in the preset, in this run) of what was scaled with `train.iterations`; empty without it."""
        if ITERATIONS not in self.given:
            return {}
        before, now = (scaled_keys(cfg.train, 1) for cfg in (self.preset(capture), self.config(capture)))
        return {key: (before[key], now[key]) for key in now if key not in self.given and before[key] != now[key]}

    def preset(self, capture: str | None = None) -> Config:
        """The same with nothing but the choices of scene, schedule and ablation: what else differs, the command set."""
        choices = self.composed(capture).choices
        return _preset((*(f"{key}={choices[key]}" for key in _PRESET), *self._of_kind(capture)))

    def composed(self, capture: str | None) -> Composed:
        """As `config`, before it is checked and scaled."""
        if capture not in self.compositions:
            self.compositions[capture] = compose([*self.overrides, *self._of_kind(capture)])
        return self.compositions[capture]

    def _of_kind(self, capture: str | None) -> list[str]:
        given = any(override.startswith("capture=") for override in self.overrides)
        return [] if capture is None or given else [f"capture={capture}"]


def command_of(keys: Sequence[str]) -> tuple[Command, Config]:
    """The `key=value` of a command line and their configuration. ValueError, one line, where one is wrong."""
    order = Command(tuple(quote_text(list(keys))))
    try:
        return order, order.config()
    except (HydraException, OmegaConfBaseException) as error:
        raise ValueError(one_line(error)) from None


@cache
def _preset(choices: tuple[str, ...]) -> Config:
    """Kept from run to run of a sweep."""
    return to_config(compose(choices).tree)


def compose(overrides: Sequence[str]) -> Composed:
    register_schema()
    within_a_run = GlobalHydra.instance().is_initialized()
    with nullcontext() if within_a_run else hydra.initialize_config_dir(str(CONFIG_DIR), version_base="1.3"):
        cfg = hydra.compose("config", list(overrides), return_hydra_config=True)
    choices = dict(cfg.hydra.runtime.choices)
    with open_dict(cfg):
        del cfg["hydra"]
    return Composed(cfg, choices)


def register_schema() -> None:
    """Make `schema` of conf/config.yaml known to Hydra. Calling it again changes nothing."""
    ConfigStore.instance().store(name="schema", node=Config)
    OmegaConf.register_new_resolver("named_after_folder", named_after_folder, replace=True)
    OmegaConf.register_new_resolver("of_scene", of_scene, replace=True)


def of_scene(schedule: str, scene: str) -> str:
    """The option of `train` with a schedule's differences for a scene; without such a file, that for its family."""
    own = f"{schedule}/{scene}"
    return own if (CONFIG_DIR / "train" / f"{own}.yaml").exists() else f"{schedule}/{scene.partition('/')[0]}"


def named_after_folder(family: str, path: str | None) -> str:
    """A scene's name, `<family>/<folder>`, so that two scenes of one layout do not share a run folder.

    Names are printed and make paths: dots in front (a hidden folder) and what cannot be printed are left out. Without a
    path, `family` alone.
    """
    folder = clear(os.path.basename(os.path.abspath(os.path.expanduser(path)))).lstrip(".") if path else ""
    return f"{family}/{folder}" if folder else family


def to_config(composed: DictConfig) -> Config:
    """The typed configuration of a run. ValueError, one line, where a key is unknown or a value out of range."""
    known = known_keys()
    tree: Any = OmegaConf.to_container(composed, resolve=False)
    for key in _keys_of(tree):
        if key not in known:  # `+key=value` on the command line gets past Hydra's own check
            raise ValueError(_unknown_key(key))
    cfg: Any = OmegaConf.to_object(composed)
    return cfg


def config_of_tree(tree: dict) -> Config:
    """The typed configuration of a run folder's config.yaml. Raises what `to_config` and OmegaConf raise."""
    merged = OmegaConf.merge(OmegaConf.structured(Config), OmegaConf.create(tree))
    assert isinstance(merged, DictConfig)
    return to_config(merged)


def known_keys(schema: type = Config, prefix: str = "") -> dict[str, Any]:
    """The type of every key of the schema, dotted: "train.lr.mean"."""
    keys: dict[str, Any] = {}
    for name, kind in get_type_hints(schema).items():
        keys[prefix + name] = kind
        if is_dataclass(kind) and isinstance(kind, type):
            keys |= known_keys(kind, f"{prefix}{name}.")
    return keys


def one_line(error: BaseException) -> str:
    """What went wrong, for people: Hydra and OmegaConf spread it over several lines and chained exceptions."""
    if isinstance(error, OSError) and error.filename is not None and error.strerror:
        return f"{error.filename}: {error.strerror}"
    chain = [error]
    while chain[-1].__cause__ is not None:
        chain.append(chain[-1].__cause__)
    text = "\n".join(str(e) for e in chain)
    where = re.search(r"In '([^']+)': \w+ raised", text)
    return (f"conf/{where[1]}.yaml: " if where else "") + (_explained(text) or _joined(error))


def _explained(text: str) -> str | None:
    """The messages of Hydra and OmegaConf that a user meets, reworded; None if it is none of these."""
    if found := re.search(r"Key '[^']*' (?:is )?not in[^\n]*\n\s*full_key: (\S+)", text):
        return _unknown_key(found[1])
    if found := re.search(r"Could not override '([^']+)'", text):
        return _unknown_key(found[1])
    if found := re.search(r"Could not find '([^']+)'", text):
        group, _, option = found[1].partition("/") if not found[1].startswith("hydra/") else found[1].rpartition("/")
        hint = "; is its package installed?" if group.startswith("hydra/") else _there_are(group)
        return f"{group}={option}: no such option{hint}"
    if found := re.search(r"You must specify '([^']+)'", text):
        return f"{found[1]}: must be given" + _there_are(found[1])
    if found := re.search(r"([^\n]+)\n\s*full_key: (\S+)", text):  # OmegaConf: a wrong type, null where it must not be
        return f"{found[2]}: {found[1]}"
    return None


def _joined(error: BaseException) -> str:
    if isinstance(error, OverrideParseException):
        return f"{error.override}: not a key=value that Hydra can read"
    lines = [line.strip() for line in str(error).splitlines() if not line.startswith("See https://hydra.cc")]
    return "; ".join(filter(None, lines)) or type(error).__name__


def quote_text(arguments: list[str], sweep: bool = False) -> list[str]:
    """Command line arguments, with paths and other text in quotes where Hydra would read something else than was typed:
    2024_11_28 and 1e3 are numbers to it.

    sweep: commas separate values, unless a file has the whole name.
    """
    return [_text_as_typed(argument, sweep) for argument in arguments]


def _text_as_typed(argument: str, sweep: bool) -> str:
    key, _, value = argument.partition("=")
    kind = known_keys().get(key.lstrip("+"))
    if kind not in (str, str | None) or (kind is not str and value.lower() == "null"):
        return argument
    read = _read(argument)
    if sweep and read and read.is_sweep_override() and read.value_type is not ValueType.SIMPLE_CHOICE_SWEEP:
        return argument  # choice(…), range(…)
    parts = [value]
    if sweep and not os.path.exists(os.path.expanduser(value)):
        parts = [part.strip() for part in re.findall(r"""(?:'[^']*'|"[^"]*"|[^,])+""", value)]
    return f"{key}=" + ",".join(map(_quoted, parts))


def _quoted(text: str) -> str:
    """For Hydra's grammar, which takes most text as it is. Text in quotes stays."""
    read = _read(f"key={text}")
    if read and (isinstance(read._value, QuotedString) or read.value() == text):
        return text
    # For Hydra a backslash escapes only before a quote, of which the one that closes the value is one.
    escaped = re.sub(r'(\\*)("|$)', lambda found: found[1] * 2 + ('\\"' if found[2] else ""), text)
    return f'"{escaped}"'


def _read(override: str) -> Override | None:
    try:
        return OverridesParser.create().parse_override(override)
    except HydraException:
        return None


def _keys_of(container: dict, prefix: str = "") -> Iterator[str]:
    for name, value in container.items():
        yield prefix + name
        if isinstance(value, dict):
            yield from _keys_of(value, f"{prefix}{name}.")


def options(group: str) -> list[str]:
    """What conf/<group> offers, nested ones too (Hydra lists the first level only). Not the files below
    conf/train/<schedule>: they are a schedule's overrides for single scenes."""
    folder = CONFIG_DIR / group
    if group == "train":
        return sorted(file.stem for file in folder.glob("*.yaml"))
    return sorted(str(file.relative_to(folder).with_suffix("")) for file in folder.rglob("*.yaml"))


def _there_are(group: str) -> str:
    found = options(group)
    return f"; there are {', '.join(found)}" if found else ""


def _unknown_key(key: str) -> str:
    siblings = [known for known in known_keys() if known.count(".") == key.count(".")]
    close = difflib.get_close_matches(key, siblings, n=1)
    return f"{key}: no such key" + (
        f"; did you mean {close[0]}?" if close else "; pipeline/config/schema.py lists them"
    )
