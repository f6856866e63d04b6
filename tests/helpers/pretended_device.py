"""A device for tests without one: tensors that say they are on it, keep their data in the CPU's memory, and refuse, as
CUDA does, to be mixed with tensors of the CPU or read by what takes the CPU's memory (NumPy, the kernel).

    with pretended_device() as device:
        tensor = torch.zeros(3, device=device)

It has the name "meta", since autograd runs what is on an unknown device of another name in a thread that needs it.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import torch
from torch.overrides import TorchFunctionMode
from torch.utils._python_dispatch import TorchDispatchMode, return_and_correct_aliasing
from torch.utils._pytree import tree_leaves, tree_map

DEVICE = torch.device("meta")
# What copies between devices.
_COPIES = {torch.ops.aten._to_copy.default, torch.ops.aten.copy_.default}

_INDEXED = {torch.ops.aten.index, torch.ops.aten.index_put}  # their indices may be the CPU's, also with CUDA


class _OnDevice(torch.Tensor):
    """A tensor of the pretended device; `held` has its data."""

    held: torch.Tensor

    @staticmethod
    def __new__(cls, held: torch.Tensor) -> _OnDevice:
        made = torch.Tensor._make_wrapper_subclass(
            cls,
            held.shape,
            strides=held.stride(),
            storage_offset=held.storage_offset(),
            dtype=held.dtype,
            device=DEVICE,
        )
        made.held = held
        return made

    __torch_function__ = torch._C._disabled_torch_function_impl

    def __repr__(self) -> str:
        return f"on a pretended device: {self.held!r}"

    @classmethod
    def __torch_dispatch__(cls, func, types, args=(), kwargs=None):
        return _run(func, args, kwargs or {})


class _Device(TorchDispatchMode):
    """Without it a tensor could not be made on the device."""

    def __torch_dispatch__(self, func, types, args=(), kwargs=None):
        return _run(func, args, kwargs or {})


class _FromNumbers(TorchFunctionMode):
    """What makes a tensor of Python's numbers, and leaves it empty where the device is called "meta"."""

    def __torch_function__(self, func, types, args=(), kwargs=None):
        kwargs = dict(kwargs or {})
        if func is torch.tensor and torch.device(kwargs.get("device") or "cpu") == DEVICE:
            return func(*args, **{**kwargs, "device": "cpu"}).to(DEVICE)
        if func is torch.Tensor.new_tensor and isinstance(args[0], _OnDevice):
            return torch.tensor(*args[1:], **{"dtype": args[0].dtype, **kwargs}).to(DEVICE)
        if func is torch.Tensor.__getitem__ and isinstance(args[1], tuple):
            args = args[0], tuple(torch.tensor(at) if isinstance(at, list) else at for at in args[1])
        return func(*args, **kwargs)


def _run(func, args, kwargs):
    tensors = [leaf for leaf in tree_leaves((args, kwargs)) if isinstance(leaf, torch.Tensor)]
    here = [tensor for tensor in tensors if isinstance(tensor, _OnDevice)]
    device = kwargs.get("device")
    if here and func not in _COPIES:
        strange = [(t.device, list(t.shape)) for t in tensors if not isinstance(t, _OnDevice) and t.ndim > 0]
        if func.overloadpacket in _INDEXED and isinstance(args[0], _OnDevice):
            strange = [(device, shape) for device, shape in strange if device == DEVICE]
        if strange:
            raise RuntimeError(f"{func}: expected all tensors on one device, found {strange}")
    wrapped = device == DEVICE if device is not None else bool(here)
    if func is torch.ops.aten.copy_.default:
        wrapped = isinstance(args[0], _OnDevice)
    inner_args, inner_kwargs = tree_map(lambda x: x.held if isinstance(x, _OnDevice) else x, (args, kwargs))
    if device == DEVICE:
        inner_kwargs = {**inner_kwargs, "device": torch.device("cpu")}
    found = func(*inner_args, **inner_kwargs)
    if not wrapped:
        return found
    found = tree_map(lambda x: _OnDevice(x) if isinstance(x, torch.Tensor) else x, found)
    return return_and_correct_aliasing(func, args, kwargs, found) if here else found


@contextmanager
def pretended_device() -> Iterator[torch.device]:
    with _Device(), _FromNumbers():
        yield DEVICE
