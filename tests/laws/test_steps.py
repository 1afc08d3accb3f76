"""Laws of steps and workers: results in order, in fixed memory, and the same for any number of workers."""

import os
import time
from collections.abc import Iterator
from concurrent.futures import CancelledError, ProcessPoolExecutor, ThreadPoolExecutor
from multiprocessing import get_context
from threading import Barrier

import cv2
import pytest

from morphspace import steps
from morphspace.errors import BadInput
from morphspace.steps import Step, check_awaited, in_order, result_of, using_workers, worker_count


def test_the_result_is_the_return_value_and_each_step_is_reported():
    def work():
        for done in (1, 2):
            yield Step("some", done, 2)
        return "finished"

    reported = []
    assert result_of(work(), reported.append) == "finished"
    assert reported == [Step("some", 1, 2), Step("some", 2, 2)]
    assert result_of(work()) == "finished"


def test_results_come_in_the_order_of_the_items_and_few_are_in_progress():
    taken = []

    def items():
        for item in range(100):
            taken.append(item)
            yield item

    results = in_order(lambda item: item * item, items(), 2)
    assert isinstance(results, Iterator)
    assert [next(results) for _ in range(3)] == [0, 1, 4]
    assert len(taken) <= 3 + 2  # two workers
    assert list(results) == [i * i for i in range(3, 100)]


@pytest.fixture
def own_threads():
    """Give OpenCV three threads, on any machine."""
    before = cv2.getNumThreads()
    cv2.setNumThreads(3)
    yield cv2.getNumThreads
    cv2.setNumThreads(before)


def test_threads_work_on_items_and_not_inside_them(own_threads):
    assert own_threads() == 3
    assert list(in_order(lambda item: own_threads(), range(5))) == 5 * [1]
    assert own_threads() == 3


def test_the_thread_limit_is_restored_after_a_failure_and_an_abandoned_loop(own_threads):
    with pytest.raises(ZeroDivisionError):
        list(in_order(lambda item: 1 // item, range(3)))
    assert own_threads() == 3
    results = in_order(lambda item: item, range(9))
    next(results)
    assert own_threads() == 1
    results.close()
    assert own_threads() == 3


def test_the_thread_limit_is_restored_by_the_last_of_several_loops(own_threads):
    first, second = (in_order(lambda item: own_threads(), range(9)) for _ in range(2))
    assert next(first) == next(second) == 1
    first.close()
    assert own_threads() == 1 and list(second) == 8 * [1]
    assert own_threads() == 3


def test_a_failure_in_a_thread_is_raised_at_its_place():
    def work(item):
        if item == 3:
            raise BadInput("three")
        return item

    results = in_order(work, range(10))
    assert [next(results) for _ in range(3)] == [0, 1, 2]
    with pytest.raises(BadInput, match="three"):
        next(results)


# how many workers


@pytest.fixture(autouse=True)
def no_variable(monkeypatch):
    monkeypatch.delenv("MORPHSPACE_WORKERS", raising=False)


@pytest.mark.parametrize("cores", [1, 3, 7])
def test_there_is_a_worker_for_each_core_this_process_may_use(monkeypatch, cores):
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: set(range(cores)), raising=False)
    monkeypatch.setattr(steps, "_memory_bytes", lambda: 2**40)
    assert worker_count() == cores


def test_there_are_fewer_workers_if_their_frames_would_fill_the_memory(monkeypatch, tmp_path):
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: set(range(64)), raising=False)
    limit = tmp_path / "memory.max"
    monkeypatch.setattr(steps, "MEMORY_LIMIT", limit)
    for words, expected in ((str(4 * steps.WORKER_BYTES), 2), ("1000", 1)):
        limit.write_text(words + "\n")
        assert worker_count() == expected
    limit.write_text("max\n")
    assert worker_count() > 2


def test_the_block_overrides_the_variable_and_the_variable_the_cores(monkeypatch):
    monkeypatch.setenv("MORPHSPACE_WORKERS", " 5 ")
    assert worker_count() == 5
    with using_workers(3):
        assert worker_count() == 3
        with using_workers(None):
            assert worker_count() == 3
    assert worker_count() == 5


@pytest.mark.parametrize("words", ["0", "-1", "two", "1.5", "\u0663"])
def test_a_variable_that_is_no_number_of_workers_is_refused(monkeypatch, words):
    monkeypatch.setenv("MORPHSPACE_WORKERS", words)
    with pytest.raises(BadInput, match=r"MORPHSPACE_WORKERS is .*expected a whole number from 1"):
        list(in_order(abs, range(3)))
    monkeypatch.setenv("MORPHSPACE_WORKERS", "")
    assert worker_count() >= 1


def test_no_worker_is_refused():
    with pytest.raises(BadInput, match="the number of workers is 0"), using_workers(0):
        pass


@pytest.mark.parametrize("count", [1, 2, 5])
def test_as_many_items_are_in_progress_as_there_are_workers(count):
    together, most = Barrier(count, timeout=60), []

    def work(item):
        together.wait()  # passes when so many are here at once
        return item

    def items():
        for item in range(4 * count):
            most.append(item)
            yield item

    with using_workers(count):
        results = in_order(work, items())
        for done in range(4 * count):
            assert next(results) == done
            assert len(most) <= done + 1 + count  # what is under way does not grow with the items


def test_an_executor_that_is_passed_in_does_the_work_and_lives_on():
    with ThreadPoolExecutor(3, thread_name_prefix="mine") as pool:
        assert list(in_order(abs, [-1, -2], pool)) == [1, 2]
        with using_workers(pool):
            assert list(in_order(abs, [-3])) == [3]
        assert pool.submit(abs, -4).result() == 4


def test_an_executor_of_processes_gives_the_results_in_order():
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
        assert list(in_order(abs, [-5, 3, -1, 0], pool)) == [5, 3, 1, 0]


def test_work_that_nobody_awaits_is_told(own_threads):
    told = []

    def work(item):
        for _ in range(20_000 if item else 0):  # far longer than the loop below lasts
            try:
                check_awaited()
            except CancelledError:
                told.append(item)
                raise
            time.sleep(0.001)
        return item

    check_awaited()  # outside of any loop
    results = in_order(work, range(3), 2)
    assert next(results) == 0
    results.close()
    assert sorted(told) in ([1], [1, 2])
    check_awaited()
