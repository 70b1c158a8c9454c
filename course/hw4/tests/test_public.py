"""Public tests: mirrors that fit on a page, and traces of a frontier."""

import adapters
import numpy as np
import torch


def test_joint_mirror_is_a_mirror():
    p = adapters.joint_mirror()
    assert isinstance(p, torch.Tensor) and p.shape == (12, 12), "a mirror is a (12, 12) matrix of torch"
    assert torch.equal(p @ p, torch.eye(12)), "looking into the mirror twice changes nothing: P P = 1"
    hips = p @ torch.tensor([0.3, -0.1] + 10 * [0.0])
    assert torch.allclose(hips, torch.tensor([0.1, -0.3] + 10 * [0.0])), (
        f"the left front hip at 0.3 and the right one at -0.1 become 0.1 and -0.3, not {hips[:2].tolist()}"
    )


def test_symmetric_part_by_hand():
    swap = adapters.pair_swap(1)
    got = adapters.symmetric_part(torch.tensor([[1.0, 2.0], [4.0, 8.0]]), swap, swap)
    expected = torch.tensor([[4.5, 3.0], [3.0, 4.5]])
    assert torch.allclose(got, expected), (
        f"[[1, 2], [4, 8]] under a swap of both: [[4.5, 3], [3, 4.5]], not {got.tolist()}"
    )


def test_frontier_by_hand():
    f = adapters.Frontier(3, window=4)
    f.finished(np.zeros(3, int), np.ones(3))
    assert f.level == 0, "three episodes of a window of four decide nothing"
    f.finished(np.array([0]), np.array([0.0]))
    assert f.level == 1, "1, 1, 1, 0 have the mean 0.75: at `up` the frontier rises"
    f.finished(np.array([1, 1, 1, 1]), np.array([0.0, 0.5, 0.25, 0.25]))
    assert f.level == 1, "a mean of 0.25 is not below `down`"
    f.finished(np.array([1, 1, 1, 1]), np.array([0.0, 0.5, 0.25, 0.2]))
    assert f.level == 0, "a mean below `down` lowers the frontier"
