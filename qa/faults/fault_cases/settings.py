"""Campaign files and protocols that were made to hurt."""

import os

from fault_cases.inputs import FAMILY, MUST, bytes_of, expect_refusal, text_of
from fault_cases.kit import add_all

_PROTOCOL = ("run", "--worlds", "0", "--out", "out", "--protocol")
_CAMPAIGN = ("campaign",)
_SCHEMA = "schema_version: 1\n"
_DEEP = "[" * 3000 + "]" * 3000
_CASES = (
    (
        "campaign-aliases",
        "A campaign file whose YAML aliases stand for 10^9 values.",
        "c.yaml",
        text_of(
            _SCHEMA
            + "a0: &a0 [x, x]\n"
            + "".join(
                f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 10)}]\n"
                for k in range(1, 10)
            )
        ),
        _CAMPAIGN,
    ),
    (
        "campaign-cycle",
        "A campaign file with a list that holds itself.",
        "c.yaml",
        text_of("planners: &a [*a]\n"),
        _CAMPAIGN,
    ),
    (
        "campaign-deep",
        "A campaign file nested 3,000 deep.",
        "c.yaml",
        text_of(f"{_SCHEMA}planners: {_DEEP}\n"),
        _CAMPAIGN,
    ),
    (
        "campaign-object",
        "A campaign file that asks for os.system.",
        "c.yaml",
        text_of(_SCHEMA + "seed: !!python/object/apply:os.system [touch owned]\n"),
        _CAMPAIGN,
    ),
    (
        "campaign-nan",
        "A campaign file with a time limit of NaN.",
        "c.yaml",
        text_of(_SCHEMA + "out: out\ntrial_limit_s: .nan\n"),
        _CAMPAIGN,
    ),
    (
        "campaign-encoding",
        "A campaign file in UTF-16 cut in the middle.",
        "c.yaml",
        bytes_of("schema_version: 1\n".encode("utf-16")[:-3]),
        _CAMPAIGN,
    ),
    (
        "campaign-endless",
        "/dev/zero by a link as a campaign file.",
        "c.yaml",
        lambda path: path.symlink_to("/dev/zero"),
        _CAMPAIGN,
    ),
    (
        "campaign-pipe",
        "A pipe that nobody writes to as a campaign file.",
        "c.yaml",
        os.mkfifo,
        _CAMPAIGN,
    ),
    (
        "protocol-type",
        "A protocol whose time limit is a list.",
        "p.yaml",
        text_of(_SCHEMA + "base: challenge\nname: x\nlimit_s: [1, 2]\n"),
        _PROTOCOL,
    ),
    (
        "protocol-huge",
        "A protocol of 30 MB.",
        "p.yaml",
        text_of(_SCHEMA + "# " + "x" * 30_000_000),
        _PROTOCOL,
    ),
    (
        "protocol-inf",
        "A protocol whose time limit is infinite.",
        "p.yaml",
        text_of(_SCHEMA + "base: challenge\nname: x\nlimit_s: .inf\n"),
        _PROTOCOL,
    ),
    (
        "protocol-digits",
        "A protocol whose time limit has 5,000 digits.",
        "p.yaml",
        text_of(_SCHEMA + f"base: challenge\nname: x\nlimit_s: {'9' * 5000}\n"),
        _PROTOCOL,
    ),
)
add_all(FAMILY, MUST, expect_refusal, _CASES)
