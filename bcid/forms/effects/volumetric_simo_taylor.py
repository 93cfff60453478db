"""The law's volumetric energy has the form simo_taylor, U = bulk (J^2 - 1 - 2 ln J)/4; see `bcid.forms.effects._volumetric`."""

from __future__ import annotations

from bcid.forms.effects._volumetric import form_effect

effect = form_effect("simo_taylor", "(J^2 - 1 - 2 ln J)/4")
