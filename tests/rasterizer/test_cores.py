"""The allocator keeps freed memory: an iteration's images and gradients cause no page faults when allocated again."""

import ctypes
import subprocess
import sys

from rasterizer.cores import keep_freed_memory

# Allocates and frees what a training iteration does: images, their gradients and the per-view gradients of a varying
# number of visible Gaussians, for four views. Prints the page faults per iteration after a warm-up.
ITERATIONS = """
import random, resource, torch
from rasterizer.cores import keep_freed_memory
assert keep_freed_memory()
rng = random.Random(1)
def faults():
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt
for iteration in range(40):
    if iteration == 20:
        before = faults()
    held = []
    for view in range(4):
        visible = rng.randint(70_000, 90_000)
        image, gradient = torch.ones(480_000), torch.ones(480_000)
        held.append([torch.ones(count * visible) for count in (1, 1, 1, 2, 8)])
    del held
print((faults() - before) // 20)
"""


def test_repeated_iterations_cause_no_page_faults():
    if not hasattr(ctypes.CDLL(None), "mallopt"):  # not glibc: nothing to set
        assert keep_freed_memory() is False
        return
    done = subprocess.run([sys.executable, "-c", ITERATIONS], capture_output=True, text=True, check=True)
    # 5,000 pages of 4 KiB are written. Measured: 0 to 20 faults, and 350 to 1,300 without the setting.
    assert int(done.stdout) < 150
