"""The public functions and their results: what they show, give as tables, write and read."""

import json
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path

import pytest
import runs
import xarray as xr

import bcid
from bcid.api.results import DiagnosisResult, IdentifyResult, Result
from bcid.base.errors import InputError
from bcid.base.run_folder import RunFolder

KINDS = {"identify": runs.identified, "explain": runs.explained, "explore": runs.explored}


class Tags(HTMLParser):
    """Whether every element that is opened is closed."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.text = ""

    def handle_starttag(self, tag: str, attrs: object) -> None:
        """One more is open."""
        self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        """The last one is closed."""
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        """What is read."""
        self.text += data


@pytest.fixture(params=[*KINDS])
def result(request: pytest.FixtureRequest, tmp_path: Path) -> Result:
    return bcid.load(KINDS[request.param](tmp_path / "run"))


def test_a_result_is_shown(result: Result) -> None:
    assert repr(result).startswith(f"<{type(result).__name__}: ")
    assert len(repr(result)) < 200
    assert "\n" not in repr(result)
    html = Tags()
    html.feed(result._repr_html_())
    assert html.open == []
    assert result.headline in html.text


def test_a_result_is_a_table(result: Result) -> None:
    table = result.to_dataframe()
    assert len(table) > 0
    assert not [name for name in table.columns if table[name].isna().all()]


def test_a_result_is_drawn(result: Result) -> None:
    figure = result.plot()
    assert len(figure.axes) > 0
    # What a notebook asks an object for.
    assert figure._repr_png_().startswith(b"\x89PNG")  # type: ignore[attr-defined]


def test_a_result_is_written_and_loaded(result: Result, tmp_path: Path) -> None:
    again = bcid.load(result.write(tmp_path / "again"))
    assert type(again) is type(result)
    assert repr(again) == repr(result)
    assert again.documents.keys() == result.documents.keys()
    with pytest.raises(InputError, match="choose another folder"):
        result.write(tmp_path / "again")


def test_lengths_are_in_metres(tmp_path: Path) -> None:
    found = bcid.load(runs.identified(tmp_path / "run"))
    assert isinstance(found, IdentifyResult)
    assert found.rms == pytest.approx(found.documents["identification.json"].rms * 1e-3)
    assert found.to_dataframe()["rms"][0] == found.rms
    models = bcid.load(runs.explained(tmp_path / "models"))
    assert isinstance(models, DiagnosisResult)
    assert models.change_point is None
    begins = {"action": "lift", "step": 5, "probability": 0.97}
    runs.rewrite(models.path, "diagnosis.json", json.dumps(runs.diagnosis() | {"change_point": begins}))
    again = bcid.load(models.path)
    assert isinstance(again, DiagnosisResult)
    assert again.change_point is not None
    assert again.change_point.to_json() == begins
    assert models.model_sequence[-1].rms == pytest.approx(0.21e-3)


def test_what_cannot_be_loaded(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="not a run folder"):
        bcid.load(tmp_path)
    run = RunFolder.start(tmp_path / "run", "identify", {})
    with pytest.raises(InputError, match="the run has not ended"):
        bcid.load(run.path)
    run.finish({})
    with pytest.raises(InputError, match="missing from the run"):
        bcid.load(run.path)
    other = RunFolder.start(tmp_path / "other", "track", {})
    other.finish({})
    with pytest.raises(InputError, match="holds a run of 'track'"):
        bcid.load(other.path)


def test_arrays_state_their_units(result: Result) -> None:
    for name in (name for name in result.documents if name.endswith(".nc")):
        data = result.documents[name]
        assert isinstance(data, xr.Dataset)
        lengths = {"points", "displacement", "measured", "predicted", "rest"} & set(data.variables)
        assert {data[variable].attrs["units"] for variable in lengths} == {"m"}


def test_functions_and_packages_do_not_share_a_name() -> None:
    """Whatever was imported before: a package of the same name would take the function's place."""
    code = (
        "import bcid, bcid.app.answer_commands, bcid.app.tool_commands, bcid.search.fitting.fit, bcid.exploration.loop"
    )
    names = ("identify", "compare", "diagnose", "fit", "explain", "explore", "simulate", "load")
    code += f"\nassert all(callable(getattr(bcid, name)) for name in {names})"
    subprocess.run([sys.executable, "-c", code], check=True)
    package = Path(bcid.__file__).parent
    assert not [name for name in names if (package / name).exists() or (package / f"{name}.py").exists()]


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        ({"anchors": ["3", "9"], "add": ["gravity"]}, "patch '9' is not in the scene"),
        ({"anchors": ["3"], "add": ["Gravity"]}, "did you mean 'gravity'"),
        ({"anchors": ["3"], "add": ["gravity: weigth = 3"]}, "has no parameter 'weigth'; did you mean 'weight'"),
        ({"anchors": ["3"], "add": ["gravity: weight = 3 mm"]}, "weight: unit 'mm' cannot be used here"),
        ({"anchors": ["3"], "add": ["soft_anchor:8"]}, "soft_anchor:8: place '8'"),
        ({"anchors": ["3"]}, "nothing to do"),
    ],
)
def test_mistakes(arguments: dict[str, list[str]], reason: str, project: Path) -> None:
    with pytest.raises(InputError, match=reason):
        bcid.fit(project / "examples/scenes/slab.toml", project / "examples/measurements/slab-34-complex", **arguments)
