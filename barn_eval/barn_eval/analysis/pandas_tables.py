"""Tables for Python users, whose pandas columns always have the same types."""

from collections.abc import Iterable, Mapping
from typing import Any

import pandas as pd
import pyarrow as pa

_TEXT_COLUMNS = ("planner", "board", "a", "b", "measure", "unit", "of", "kind", "name")
_COUNT_COLUMNS = ("world", "worlds", "trials", "rank", "repetitions")
# Whole numbers that not every row has.
_NULLABLE_COUNTS = ("recoveries",)
_PANDAS_TYPES = {pa.string(): pd.StringDtype()}


def pandas_table(rows: Iterable[Mapping[str, Any]], **types: str) -> pd.DataFrame:
    """Return dict rows as a DataFrame with fixed column types, float64 by default.

    Args:
        rows: Values by column; a missing number becomes NaN.
        **types: pandas types of columns that the suite has no rule for.
    """
    # pandas infers types from values, so a column with only missing values or whole
    # numbers would get another type than usual.
    table = pd.DataFrame(list(rows))
    column_types = {
        **dict.fromkeys(_TEXT_COLUMNS, "string"),
        **dict.fromkeys(_COUNT_COLUMNS, "int64"),
        **types,
    }
    return table.astype(
        {column: column_types.get(column, "float64") for column in table.columns}
    )


def pandas_of_arrow(table: pa.Table) -> pd.DataFrame:
    """Return an Arrow table as a DataFrame, texts as string, recoveries as Int64."""
    converted = table.to_pandas(types_mapper=_PANDAS_TYPES.get)
    nullable = set(_NULLABLE_COUNTS).intersection(converted.columns)
    return converted.astype(dict.fromkeys(nullable, "Int64"))
