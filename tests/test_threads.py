"""Results are the same to the byte: with one thread and two, and asked for from several threads at once."""

from __future__ import annotations

import threading
from collections.abc import Iterator

import numpy as np
import pytest
import torch
from conftest import Shape, make_tabletop

from mapping import ContraMap, MapConfig
from mapping.lanes import LANES
from mapping.threads import Threads, thread_count
from mapping.tiled_features import SHARED_FROM
from reconstruction import reconstruct


@pytest.fixture
def threads() -> Iterator:
    """torch.set_num_threads, undone at the end."""
    before = torch.get_num_threads()
    yield torch.set_num_threads
    torch.set_num_threads(before)


def fitted(samples: int = LANES * SHARED_FROM + 500) -> np.ndarray:
    rng = np.random.default_rng(1)
    X = rng.uniform(-0.2, 0.2, (samples, 3)).astype(np.float32)
    y = (np.linalg.norm(X, axis=1) < 0.12).astype(int)
    hinges = rng.uniform(-0.2, 0.2, (300, 3)).astype(np.float32)
    return ContraMap(MapConfig(gamma=1000.0)).fit(X, y, hinges=hinges).W.numpy().copy()


@pytest.mark.parametrize("samples", [500, LANES * SHARED_FROM + 500])
def test_one_thread_and_two_fit_the_same_weights(threads, samples: int) -> None:
    threads(1)
    one = fitted(samples)
    threads(2)
    assert (fitted(samples) == one).all()


def test_one_thread_and_two_make_the_same_meshes(threads) -> None:
    frame = make_tabletop((Shape("sphere", (0.05,), (0.0, 0.0, 0.05)),), size=(120, 90), noise=0.001).frame
    found = []
    for count in (1, 2):
        threads(count)
        found.append(reconstruct(frame).objects[0])
    assert (found[0].mesh.vertices == found[1].mesh.vertices).all()
    assert (found[0].uncertainty == found[1].uncertainty).all()


@pytest.mark.parametrize("count", [2, 3])
def test_several_threads_at_once_get_what_one_gets(threads, count: int) -> None:
    """While one works, torch's count is one for all; others took that for theirs, and MKL took either."""
    threads(count)
    alone = fitted()
    found: list[np.ndarray] = []

    def ask() -> None:
        for _ in range(3):
            found.append(fitted())

    asking = [threading.Thread(target=ask) for _ in range(4)]
    for one in asking:
        one.start()
    for one in asking:
        one.join()
    assert len(found) == 12
    assert all((weights == alone).all() for weights in found)
    assert thread_count() == torch.get_num_threads() == count


def test_work_that_is_split_again_stays_with_its_thread(threads) -> None:
    threads(3)

    def inner(number: int) -> tuple[int, int]:
        with Threads() as again:
            return number, again.count

    with Threads() as outer:
        assert outer.count == 3
        assert outer.map(inner, range(6)) == [(number, 1) for number in range(6)]
    assert thread_count() == 3
