"""Names and messages that would be scripts, markup or addresses if a page took them for more than text."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import runs

PAYLOADS = [
    "<script>alert(1)</script>",
    "</script><script>alert(2)</script>",
    "<img src=x onerror=alert(3)>",
    "<svg onload=alert(4)>",
    "<svg><script>alert(5)</script></svg>",
    '"><script>alert(6)</script>',
    "'><img src=x onerror=alert(7)>",
    "<iframe src='javascript:alert(8)'></iframe>",
    "<a href='javascript:alert(9)'>here</a>",
    "<body onload=alert(10)>",
    "<style>@import 'http://example.invalid/11.css';</style>",
    "<link rel=stylesheet href=http://example.invalid/12.css>",
    "<meta http-equiv=refresh content='0;url=http://example.invalid/13'>",
    "<base href=http://example.invalid/14/>",
    "<form action=http://example.invalid/15><input autofocus onfocus=alert(15)>",
    "<object data=http://example.invalid/16></object>",
    "<embed src=http://example.invalid/17>",
    "<video><source onerror=alert(18)></video>",
    "<details open ontoggle=alert(19)>",
    "<math><mtext><script>alert(20)</script></mtext></math>",
    "--><script>alert(21)</script><!--",
    "<!--<script>alert(22)//",
    "]]><script>alert(23)</script><![CDATA[",
    "</style><script>alert(24)</script>",
    "</title><script>alert(25)</script>",
    "</textarea><script>alert(26)</script>",
    "</svg><script>alert(27)</script>",
    "</text><script>alert(28)</script><text>",
    "</table><script>alert(29)</script>",
    "</pre><script>alert(30)</script>",
    "&lt;script&gt;alert(31)&lt;/script&gt;",
    "&#60;script&#62;alert(32)&#60;/script&#62;",
    "\\u003cscript\\u003ealert(33)\\u003c/script\\u003e",
    "\u2028alert(34)\u2029",
    '"onmouseover=alert(35) x="',
    "' onclick='alert(36)",
    "` onclick=`alert(37)",
    "{{7*7}}${alert(38)}<%= 38 %>",
    "';alert(39);//",
    "\\';alert(40);//",
    "<scr<script>ipt>alert(41)</scr</script>ipt>",
    "<SCRIPT SRC=//example.invalid/42.js></SCRIPT>",
    "<img src='http://example.invalid/43.png'>",
    "<svg><use href='http://example.invalid/44.svg#x'/></svg>",
    "<p style='background:url(http://example.invalid/45)'>",
    "$\\frac{1}{$ 46 $\\href{http://example.invalid}{x}$",
    "\x00<script>alert(47)</script>\x1b[31m",
    "\u202e<script>alert(48)</script>",
    "\ud800<script>alert(49)</script>",
    "<x " * 400 + "onload=alert(50)>",
]


def file_name(payload: str) -> str:
    """A payload as the name of a file."""
    return payload.replace("/", "∕").replace("\x00", "").encode("utf-8", "replace").decode()[:60]


def poisoned(path: Path, payload: str) -> Path:
    """A finished run of `bcid explain` with a payload in every name, label and message that a run folder holds."""
    arrays = payload.replace("\x00", "").encode("utf-8", "replace").decode()
    run = runs.started(path)
    row = runs.ranked(payload, 1.0, 0.21) | {"place": payload, "confounded_with": [payload]}
    row["parameters"] = {payload: {"value": 1.0, "stderr": 0.1, "unit": payload}}
    found = runs.diagnosis() | {
        "verdict": payload,
        "model": payload,
        "warnings": [payload],
        "anchored": [payload],
        "ambiguous_with": [payload],
        "change_point": {"action": payload, "step": 5, "probability": 0.9},
        "scene_sensitivity": [
            runs.answer_at(2.0, [payload]) | {"label": payload, "shift": payload, "verdict": payload}
        ],
        "next_steps": [{"kind": payload, "text": payload, "expected_bits": 0.4, "positions": []}],
        "ranking": [row, runs.ranked("gravity", 0.3)],
        "selected_effects": [{"effect": payload, "place": payload, "parameters": row["parameters"]}],
        "tests": [{"name": payload, "p_value": 0.5, "decides": True, "text": payload}],
        "model_sequence": [
            runs.rung(payload, 1.4, False),
            runs.rung(f"{payload} + {payload}", 0.2, True) | {"anchored": [payload]},
        ],
    }
    runs.rewrite(path, "diagnosis.json", json.dumps(found))
    identified: dict[str, Any] = runs.identification() | {
        "anchored": [payload],
        "patches": {payload: 0.9, "right": 0.1},
    }
    identified["alternatives"][0]["anchored"] = [payload]
    runs.rewrite(path, "identification.json", json.dumps(identified))
    explored = json.loads(json.dumps(runs.exploration()))
    explored |= {"anchored": [payload], "effect": payload, "patches": {payload: 1.0}}
    for step in explored["steps"]:
        step |= {"grasp": payload, "direction": payload, "patches": {payload: 0.5}, "effects": {payload: 0.5, "": 0.5}}
        step["posterior"][0] |= {"anchored": [payload], "effect": payload}
    runs.rewrite(path, "exploration.json", json.dumps(explored))
    run.write_dataset("body.nc", runs.body(("", f"patch {arrays}", "patch right", f"grasp {arrays}"), arrays))
    seen = runs.positions(arrays, (arrays, "2"), (arrays, "b", "c"))
    seen.attrs = {"model_first": arrays, "model": f"{arrays} + x"}
    run.write_dataset("residuals.nc", seen)
    (path / "summary.txt").write_bytes(payload.encode("utf-8", "surrogatepass"))
    record = json.loads((path / "run.json").read_text(encoding="utf-8"))
    record |= {
        "state": "finished",
        "command": payload,
        "seconds": 1.0,
        "inputs": {"scene": payload, "measurement": [payload], payload: {payload: payload}},
        "versions": {payload: payload, "bcid": payload},
        "names": {"scene": payload, "measurement": payload},
        "trajectories": {payload: payload},
        "mesh": payload,
        "started": payload,
        "ranks": payload,
    }
    (path / "run.json").write_text(json.dumps(record), encoding="utf-8")
    runs.seal(path, "body.nc", "residuals.nc")
    run.release()
    return path
