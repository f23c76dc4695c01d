"""The other side of a node in its tests: a node in this process, and the node under test as a process of its own.

A test of a package that is installed without ROS imports this behind `importorskip("rclpy")`.
"""

import signal
import subprocess
import sys
import time

import rclpy
from rclpy.executors import SingleThreadedExecutor
from std_srvs.srv import Trigger

LIMIT_S = 600.0  # nothing takes so long unless it hangs


class Peer:
    """A node in a context of its own, which runs only while it waits."""

    def __init__(self, name: str = "peer") -> None:
        self.context = rclpy.Context()
        rclpy.init(context=self.context)
        self.node = rclpy.create_node(name, context=self.context, enable_rosout=False)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)

    def wait(self, done, what: str = "") -> None:
        """Spin until a condition holds; fail after a while."""
        deadline = time.monotonic() + LIMIT_S
        while not done():
            assert time.monotonic() < deadline, f"timed out waiting for {what}"
            self.executor.spin_once(timeout_sec=0.05)

    def call(self, name: str, kind: type = Trigger, **fields):
        """Call a service with the fields of its request, and return what it answers."""
        client = self.node.create_client(kind, name)
        self.wait(client.service_is_ready, name)
        future = client.call_async(kind.Request(**fields))
        self.wait(future.done, name)
        self.node.destroy_client(client)
        return future.result()

    def close(self) -> None:
        self.executor.shutdown()
        self.node.destroy_node()
        rclpy.shutdown(context=self.context)


class Process:
    """A node of the suite: words that Python runs it by, and its parameters."""

    def __init__(self, *words: str, **parameters) -> None:
        arguments = [
            part
            for name, value in parameters.items()
            for part in ("-p", f"{name}:={value}")
        ]
        command = [sys.executable, *words, "--ros-args", *arguments]
        self.process = subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
        )

    def end(self) -> tuple[int, str]:
        """Wait for its end and return its exit code and what it said."""
        try:
            output, _ = self.process.communicate(timeout=LIMIT_S)
        except subprocess.TimeoutExpired:
            self.process.kill()
            raise
        return self.process.returncode, output

    def stop(self, number: int = signal.SIGINT) -> tuple[int, str]:
        """Tell it to end, and wait."""
        if self.process.poll() is None:
            self.process.send_signal(number)
        return self.end()
