"""Pins what pip chooses today for a list of wheels: ``python environment/relock.py WANTED PINNED``, in the private tree."""

import json
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

PIP = ["/usr/bin/python3", "-m", "pip", "install", "--dry-run", "--quiet", "--break-system-packages", "--no-cache-dir"]


def main(wanted: Path, pinned: Path) -> None:
    """Write the pins, sorted by name."""
    with TemporaryDirectory() as folder:
        report = Path(folder) / "report"
        subprocess.run([*PIP, "--report", str(report), "-r", str(wanted)], check=True)
        chosen = [package["metadata"] for package in json.loads(report.read_text(encoding="utf-8"))["install"]]
    # Lines such as  name==1.2; python_version < "3.12"  stay, and the new pin is for the other Pythons.
    written = wanted.read_text(encoding="utf-8").splitlines()
    older = {line.split("==")[0]: line.strip() for line in written if "python_version <" in line}
    lines = ["# Made by ./dev relock from wheels.in: every wheel above the system packages."]
    for name, version in sorted((p["name"].lower().replace("_", "-"), p["version"]) for p in chosen):
        newer = "; " + older[name].split(";")[1].strip().replace("<", ">=") if name in older else ""
        lines += [f"{name}=={version}{newer}", *([older[name]] if name in older else [])]
    pinned.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
