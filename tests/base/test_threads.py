"""Work shared out to threads: its order, its errors, and who waits for whom."""

import threading
import time

import pytest

from deadtime.base import threads


@pytest.fixture(params=[1, 3])
def count(request, monkeypatch):
    monkeypatch.setattr(threads, "processors", lambda: request.param)
    return request.param


def test_results_come_in_the_order_of_what_was_asked(count):
    def late_first(i):
        time.sleep(0.01 * (5 - i))
        return i * i

    assert list(threads.in_order(late_first, range(5))) == [0, 1, 4, 9, 16]
    assert list(threads.in_order(late_first, [])) == []


def test_an_error_is_that_of_the_work_and_ends_the_rest(count):
    done = []

    def fails(i):
        if i == 1:
            raise TimeoutError("of its own")
        done.append(i)
        return i

    found = threads.in_order(fails, range(100))
    assert next(found) == 0
    with pytest.raises(TimeoutError, match="of its own"):
        next(found)


def test_as_many_are_at_work_as_there_are_processors(count):
    meeting = threading.Barrier(count, timeout=10.0)
    assert len(list(threads.in_order(lambda _: meeting.wait(), range(count)))) == count


def test_no_more_than_eight_are_at_work(monkeypatch):
    monkeypatch.setattr(threads, "processors", lambda: 64)
    names = threads.in_order(lambda _: threading.current_thread().name, range(100))
    assert len(set(names)) <= 8


def test_who_is_at_work_is_known_until_it_returns(monkeypatch):
    monkeypatch.setattr(threads, "processors", lambda: 2)
    go_on = threading.Event()
    found = threads.in_order(lambda i: i or go_on.wait(10.0), [1, 0])
    assert next(found) == 1
    found.close()
    assert threads.at_work()
    go_on.set()
    for thread in threads._SERVING:
        thread.join(10.0)
    assert not threads.at_work()
