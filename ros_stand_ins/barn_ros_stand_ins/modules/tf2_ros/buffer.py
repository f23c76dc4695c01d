"""A buffer of transforms that waits for them."""

import time as wall
from functools import partial

from rclpy.clock import Clock, JumpThreshold
from rclpy.duration import Duration
from rclpy.task import Future
from tf2_py import BufferCore

from tf2_ros.buffer_interface import BufferInterface

_POLL_S = 0.02


class Buffer(BufferCore, BufferInterface):
    """Transforms of the last seconds; a clock that jumps back clears it."""

    def __init__(self, cache_time=None, node=None):
        """Keep transforms for a Duration, by default 10 s; follow the node's clock."""
        BufferCore.__init__(self, cache_time)
        BufferInterface.__init__(self)
        self._waiting = []
        self.clock = node.get_clock() if node else Clock()
        threshold = JumpThreshold(
            min_forward=None, min_backward=Duration(seconds=-1), on_clock_change=True
        )
        self.jump_handle = self.clock.create_jump_callback(
            threshold, post_callback=lambda _: self.clear()
        )

    def _set(self, transform, authority, is_static):
        super()._set(transform, authority, is_static)
        for check in list(self._waiting):
            check()

    def lookup_transform(self, target_frame, source_frame, time, timeout=Duration()):
        """Return a transform; wait for it as long as the timeout."""
        self.can_transform(target_frame, source_frame, time, timeout)
        return self.lookup_transform_core(target_frame, source_frame, time)

    def lookup_transform_full(
        self,
        target_frame,
        target_time,
        source_frame,
        source_time,
        fixed_frame,
        timeout=Duration(),
    ):
        """Return a transform between two times; wait for it as long as the timeout."""
        where = (target_frame, target_time, source_frame, source_time, fixed_frame)
        self.can_transform_full(*where, timeout)
        return self.lookup_transform_full_core(*where)

    def can_transform(
        self,
        target_frame,
        source_frame,
        time,
        timeout=Duration(),
        return_debug_tuple=False,
    ):
        """Return whether a transform comes within the timeout."""
        ask = partial(self.can_transform_core, target_frame, source_frame, time)
        return _wait(ask, timeout, return_debug_tuple)

    def can_transform_full(
        self,
        target_frame,
        target_time,
        source_frame,
        source_time,
        fixed_frame,
        timeout=Duration(),
        return_debug_tuple=False,
    ):
        """Return whether a transform between two times comes within the timeout."""
        where = (target_frame, target_time, source_frame, source_time, fixed_frame)
        ask = partial(self.can_transform_full_core, *where)
        return _wait(ask, timeout, return_debug_tuple)

    async def lookup_transform_async(self, target_frame, source_frame, time):
        """Return a transform once it is known."""
        return await self.wait_for_transform_async(target_frame, source_frame, time)

    async def lookup_transform_full_async(self, *where):
        """Return a transform between two times once it is known."""
        return await self.wait_for_transform_full_async(*where)

    def wait_for_transform_async(self, target_frame, source_frame, time):
        """Return a future of a transform."""
        return self._future(
            partial(self.can_transform_core, target_frame, source_frame, time),
            partial(self.lookup_transform_core, target_frame, source_frame, time),
        )

    def wait_for_transform_full_async(self, *where):
        """Return a future of a transform between two times."""
        return self._future(
            partial(self.can_transform_full_core, *where),
            partial(self.lookup_transform_full_core, *where),
        )

    def _future(self, ask, lookup):
        future = Future()

        def check():
            if ask()[0] and not future.done():
                self._waiting.remove(check)
                future.set_result(lookup())

        self._waiting.append(check)
        check()
        return future


def _wait(ask, timeout, return_debug_tuple):
    """Return the answer once it is yes, at the latest after the timeout."""
    deadline_s = wall.monotonic() + timeout.nanoseconds * 1e-9
    answer = ask()
    while not answer[0] and wall.monotonic() < deadline_s:
        wall.sleep(_POLL_S)
        answer = ask()
    return answer if return_debug_tuple else answer[0]
