"""The page of a campaign that updates itself.

From the files alone, and nothing but what belongs to the folder.
"""

import http.client
import json
import re
import shutil
import socket
import struct
import subprocess
from urllib.parse import quote

import pytest
from refusals import refused
from report_work import EVIL, campaign, rewrite_rows
from waiting import barn_words

from barn_eval.pages.live.server import PageServer, RunState, read_state
from barn_eval.results.folder import read_results
from barn_eval.results.rows import RowFile


@pytest.fixture
def folder(run, tmp_path):
    return campaign(tmp_path / "campaign", run, faster=2.0)


def port_of(page):
    return int(page.url.split(":")[2].strip("/"))


def get(page, path, host="localhost"):
    connection = http.client.HTTPConnection(page.url.split("/")[2], timeout=600)
    connection.request("GET", path, headers={"Host": host})
    answer = connection.getresponse()
    return answer.status, answer.read().decode(), answer.headers


def cut(folder, count):
    lines = (folder / "results.jsonl").read_text().splitlines(keepends=True)
    torn = "".join(lines[count : count + 1])[:50]
    (folder / "results.jsonl").write_text("".join(lines[:count]) + torn)
    return lines


def test_the_state_is_that_of_the_files_and_follows_them(folder):
    lines = cut(folder, 20)
    state = RunState(folder)
    first = state.read()
    assert (first["done"], first["planned"], first["problem"]) == (20, 32, "")
    assert state.read() is first
    assert sum(count for _, count in first["outcomes"]) == 20
    assert first["verdict"].startswith(
        "gap ranks first; its lead over DWA is not significant"
    )
    assert [bar["label"] for bar in first["bars"]] == ["gap", "DWA"]
    assert first["notes"][0].startswith("Only 5 worlds")
    (folder / "results.jsonl").write_text("".join(lines))
    after = state.read()
    assert after["done"] == 32
    rows = RowFile(folder).read()
    failures = [row.trial_id for row in rows if not row.scores.success]
    assert [trial["id"] for trial in after["failures"]] == failures[::-1]


def test_rate_and_time_left_are_those_of_the_trials(folder):
    def with_start(place, row):
        time = f"2026-01-01T00:00:{5 * place:02d}+00:00"
        row["wall_clock"] |= {"started_at": time, "duration_s": 4.0}
        return row

    rewrite_rows(
        folder, lambda rows: [with_start(*row) for row in enumerate(rows[:11])]
    )
    state = read_state(folder)
    assert state["last"] == "2026-01-01T00:00:54+00:00"
    assert state["per_minute"] == pytest.approx(12.0)
    assert state["left_s"] == pytest.approx(21 * 5.0)


def test_a_campaign_without_a_result_and_a_damaged_one_are_shown(folder):
    state = RunState(folder)
    cut(folder, 0)
    assert state.read()["verdict"] == "No trial has ended yet."
    (folder / "results.jsonl").write_text("nonsense\n")
    assert "results.jsonl" in state.read()["problem"]
    with refused(r"run\.json"):
        RunState(folder / "bags")


def test_a_file_that_could_not_be_read_once_is_read_again(folder, monkeypatch):
    def fail(_):
        raise OSError("too many open files")

    state = RunState(folder)
    with monkeypatch.context() as patch:
        patch.setattr("barn_eval.pages.live.server.read_state", fail)
        assert state.read()["problem"] == "too many open files"
    second = state.read()
    assert (second["problem"], second["done"]) == ("", 32)


def test_the_page_and_replays_are_served_and_nothing_else(folder):
    outside = folder.parent / "outside"
    shutil.copytree(folder / "bags" / "gap_w0000_r00", outside)
    shutil.rmtree(folder / "bags" / "dwa_w0000_r00")
    (folder / "bags" / "dwa_w0000_r00").symlink_to(outside)
    (folder / "bags" / "stranger").mkdir()
    with PageServer(folder, port=0) as page:
        assert page.url.startswith("http://127.0.0.1:")
        status, text, headers = get(page, "/")
        assert status == 200
        assert EVIL not in text
        assert "default-src 'none'" in headers["Content-Security-Policy"]
        assert json.loads(get(page, "/state")[1])["done"] == 32
        assert "Plan view of the trial" in get(page, "/replay/gap_w0000_r00")[1]
        for path in (
            "/run.json", "/results.jsonl", "/bags/gap_w0000_r00/metadata.yaml", "/../run.json", "//etc/passwd",
            "/replay/", "/replay/..", "/replay/../run.json", "/replay/..%2f..%2foutside", "/replay/stranger",
            "/replay/dwa_w0000_r00", "/replay/dwa_w0005_r00", "/replay/%00", "/replay/" + quote(str(outside), safe="")
        ):  # fmt: skip
            assert get(page, path)[0] == 404, path
        assert get(page, "/state", "evil.example")[0] == 403
        assert get(page, "/state", "[::1")[0] == 403
        assert get(page, "/state", "127.0.0.1:1")[0] == 200
    with pytest.raises(OSError, match="refused"):
        get(page, "/")


def test_names_of_no_trial_are_refused_without_a_look(folder):
    loop = folder.parent / "loop"
    loop.symlink_to(loop)
    with PageServer(folder, port=0) as page:
        for name in (str(loop), "\0"):
            status, text, _ = get(page, f"/replay/{quote(name, safe='')}")
            assert (status, "there is no bag" in text) == (404, True), name


def test_nothing_is_written_and_a_taken_port_is_told(folder):
    before = {path: path.stat().st_mtime_ns for path in folder.rglob("*")}
    with PageServer(folder, port=0) as page:
        assert get(page, "/replay/gap_w0000_r00")[0] == 200
        with refused(r"port \d+: cannot be served"):
            PageServer(folder, port=port_of(page))
    assert {path: path.stat().st_mtime_ns for path in folder.rglob("*")} == before
    with refused("host 'nowhere"):
        PageServer(folder, host="nowhere.invalid", port=0)


def test_a_client_that_leaves_early_causes_no_traceback(folder, capfd):
    with PageServer(folder, port=0) as page:
        for _ in range(5):
            with socket.create_connection(("127.0.0.1", port_of(page))) as client:
                # closed by a reset
                now = struct.pack("ii", 1, 0)
                client.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, now)
                client.sendall(b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\n")
        assert get(page, "/state")[0] == 200
    assert capfd.readouterr().err == ""


def test_the_command_says_where_and_ends_on_ctrl_c(folder):
    command = barn_words(f"watch {folder} --port 0")
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
        line = process.stderr.readline()
        assert line.startswith("http://127.0.0.1:")
        process.send_signal(2)
        assert process.wait(600) == 130


def test_the_page_updates_and_failures_lead_to_replays(folder, open_page):
    lines = cut(folder, 12)
    with PageServer(folder, port=0) as served:
        page = open_page(served.url)
        text = page.locator("#progress-text")
        assert text.text_content().startswith("12 of 32 trials")
        (folder / "results.jsonl").write_text("".join(lines))
        text.filter(has_text=re.compile("^32 of 32 trials, finished")).wait_for()
        rows = read_results(folder)
        failed = {row.trial_id for row in rows if not row.scores.success}
        assert set(page.locator("#failures td.id").all_text_contents()) == failed
        assert page.evaluate("window.evil") is None
        assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
        with page.expect_popup() as replay:
            page.click("#latest a")
        replay.value.wait_for_selector("body[data-ready]")
