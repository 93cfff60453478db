"""What can go wrong must be able to: nothing is taken from where it was kept."""

import pytest

from bcid.forms.mesh.kept_meshes import VARIABLE


@pytest.fixture(autouse=True)
def nothing_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(VARIABLE, raising=False)
