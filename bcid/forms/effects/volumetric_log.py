"""The law's volumetric energy has the form log, U = bulk (ln J)^2/2; see `bcid.forms.effects._volumetric`."""

from __future__ import annotations

from bcid.forms.effects._volumetric import form_effect

effect = form_effect("log", "(ln J)^2/2")
