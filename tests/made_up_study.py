"""A study's trials, made up without any simulation: what was planted in them is known."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd


def cohort(effect: float, seed: int = 0, trials: int = 6) -> pd.DataFrame:
    """10 and 18 subjects of random effects; training lowers the error in set 3 by ``effect``."""
    random = np.random.default_rng(seed)
    rows: list[dict[str, Any]] = []
    for k in range(28):
        group, base = ("control" if k < 10 else "training"), random.normal(0.65, 0.06)
        for number, set_ in enumerate(("set1", "set2", "set3")):
            gain = 0.02 * number + (effect if group == "training" and number == 2 else 0.0)
            for trial in range(1, trials + 1):
                error = float(base - gain + random.normal(0.0, 0.03))
                success = bool(error < 0.6)
                filtered = group == "training" and number == 1
                rows.append(
                    {
                        "name": f"S{k:02d}{set_}{trial}", "subject": f"S{k:02d}", "group": group, "set": set_,
                        "trial": trial, "mode": "training" if filtered else "off", "seed": trial, "success": success,
                        "rms_error": error, "balance_time": 5.0 * success, "time_to_success": 10.0 if success else 30.0,
                        "pra": float(np.clip(error - 0.3 + random.normal(0.0, 0.05), 0, 1)) if filtered else 0.0,
                    }
                )  # fmt: skip
    return pd.DataFrame(rows)
