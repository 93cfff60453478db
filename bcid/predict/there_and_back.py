"""A pull that leads back the way it came: its way there, and which frames of it are seen again on the way back."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from bcid.measurement import Action


def there(action: Action, steady: bool) -> Action:
    """The motion up to where it turns and goes the same way back, frames numbered from 0; all of it where it does not.

    Nor where the body is not `steady`: its state depends on time, or on what was before.
    """
    count = _turning(action) if steady else len(action)
    return replace(action.until(count), frames=np.arange(count), times=action.clock[:count])


def back(action: Action, steady: bool) -> NDArray[np.int64]:
    """For each frame of a motion, that of the way there in which the body is the same; shape (frames,)."""
    frames = np.arange(len(action))
    return np.minimum(frames, frames[::-1]) if len(there(action, steady)) < len(action) else frames


def _turning(action: Action) -> int:
    """Number of steps to where the motion turns and goes the same way back; all steps where it does not."""
    same = np.allclose(action.translation, action.translation[::-1], atol=1e-9) and np.allclose(
        action.rotation, action.rotation[::-1], atol=1e-9
    )
    loaded = any(not np.allclose(load, load[::-1]) for load in action.loads.values())
    return len(action) // 2 + 1 if same and not loaded and len(action) % 2 else len(action)
