"""Tables in Python: DataFrames whose columns have the same types whatever is in them."""

from collections.abc import Iterable, Mapping
from typing import Any

import pandas as pd
import pyarrow as pa

TEXTS = ("planner", "board", "a", "b", "measure", "unit", "of", "kind", "name")
COUNTS = ("world", "worlds", "trials", "rank", "repetitions")
_MAY_LACK = ("recoveries",)  # whole numbers that not every row has
_ARROW = {pa.string(): pd.StringDtype()}


def frame_of(rows: Iterable[Mapping[str, Any]], **kinds: str) -> pd.DataFrame:
    """Return rows as a DataFrame: texts, counts, and all else numbers, NaN where there is none.

    kinds: types of columns that are none of these.
    """
    frame = pd.DataFrame(list(rows))
    known = dict.fromkeys(TEXTS, "string") | dict.fromkeys(COUNTS, "int64") | kinds
    return frame.astype({name: known.get(name, "float64") for name in frame.columns})


def frame(table: pa.Table) -> pd.DataFrame:
    """Return a table as a DataFrame."""
    made = table.to_pandas(types_mapper=_ARROW.get)
    return made.astype({name: "Int64" for name in _MAY_LACK if name in made.columns})
