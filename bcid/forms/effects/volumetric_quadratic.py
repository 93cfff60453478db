"""The law's volumetric energy has the form quadratic, U = bulk (J - 1)^2/2; see `bcid.forms.effects._volumetric`."""

from __future__ import annotations

from bcid.forms.effects._volumetric import form_effect

effect = form_effect("quadratic", "(J - 1)^2/2")
