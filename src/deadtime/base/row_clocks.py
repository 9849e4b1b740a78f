"""Times of the rows of a log, in seconds from its first row, whatever its clock counts.

Numbers count seconds, or smaller units since 1970 if only that gives a date of this time. Stamps
are dates with times of day, of which the notation is the one that all rows have and in which time
does not go back. Differences are computed in decimals: two floats that count from 1970 would lose
seven digits.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from datetime import UTC, datetime, timedelta
from decimal import Decimal, InvalidOperation
from math import isfinite
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from deadtime.base.errors import ArgumentError

TIMES = ("t", "time")  # names of the column of times, the preferred one first
UNITS = {"s": 0, "ms": -3, "us": -6, "ns": -9}  # of a clock, and their powers of ten
_LATEST = 10**11  # seconds: counted from 1970 the year 5138
_THIS_AGE = 1_000_000_000, 3_000_000_000  # seconds since 1970: the years 2001 to 2065
_ONE_DAY = "times hh:mm:ss of one day"
_DAY, _HOUR = 86_400, 3_600
_CONTINUOUS = 20.0  # medians: a reading of dates with no longer step is right beside one with days
_TIME_OF_DAY = re.compile(
    r"(?P<date>[^:]*?)(?:(?P<hour>\d{1,4}):(?P<minute>\d{2})(?::(?P<second>\d{2}))?"
    r"(?:[.,](?P<fraction>\d+))?\s*(?P<zone>[^:]*(?::\d{2})?))?"
)
_COMPACT = re.compile(r"(\d{8})T(\d{2})(\d{2})(\d{2})(.*)")  # ISO 8601 without signs
_ZONE = re.compile(r"([+-])(\d{2}):?(\d{2})?")
_DATES = {
    "%Y-%m-%d": "yyyy-mm-dd",
    "%Y/%m/%d": "yyyy/mm/dd",
    "%Y.%m.%d": "yyyy.mm.dd",
    "%Y%m%d": "yyyymmdd",
    "%d.%m.%Y": "dd.mm.yyyy",
    "%d.%m.%y": "dd.mm.yy",
    "%d/%m/%Y": "dd/mm/yyyy",
    "%m/%d/%Y": "mm/dd/yyyy",
    "%d/%m/%y": "dd/mm/yy",
    "%m/%d/%y": "mm/dd/yy",
    "%d-%m-%Y": "dd-mm-yyyy",
    "%m-%d-%Y": "mm-dd-yyyy",
    "%d-%m-%y": "dd-mm-yy",
    "%y-%m-%d": "yy-mm-dd",
    "%d-%b-%Y": "dd-mon-yyyy",
    "%d-%b-%y": "dd-mon-yy",
    "%d %b %Y": "dd mon yyyy",
    "%b %d %Y": "mon dd yyyy",
    "%b %d, %Y": "mon dd, yyyy",
}


class RowClock(NamedTuple):
    """Times of rows.

    seconds : from the first row; may repeat or go back, see `require_rising`
    first : the time of the first row on a clock that counts seconds, else 0
    notation : a phrase on the notation; empty for plain seconds
    """

    seconds: Float[np.ndarray, " row"]
    first: float
    notation: str = ""
    unit: Decimal = Decimal(1)
    origin: Decimal = Decimal(0)

    def at(self, value: float) -> float:
        """A value of the log's own clock in seconds from the first row."""
        return float((Decimal(repr(float(value))) - self.origin) * self.unit)


def clock_of(
    cells: Sequence[str], place: Callable[[int], str], column: str, unit: str | None = None
) -> RowClock:
    """The clock of a column of times.

    cells : not empty, decimals with points; place : names a row in messages; unit : of numbers

    Examples
    --------
    >>> clock_of(["02.03.2026 08:15:00", "02.03.2026 08:15:00,5"], str, "t")[:3:2]
    (array([0. , 0.5]), 'times dd.mm.yyyy hh:mm:ss from 2026-03-02 08:15:00')
    """
    if unit is not None and unit not in UNITS:
        raise ArgumentError(f"unit must be one of {', '.join(UNITS)}, got {unit!r}.")
    if not cells:
        return RowClock(np.zeros(0), 0.0)
    if _looks_like_a_stamp(cells[0]):
        return _stamped(cells, place, column)
    values = [_decimal(f"{place(row)}: {column}", cell) for row, cell in enumerate(cells)]
    first, size, notation = values[0], abs(values[0]), ""
    low, high = _THIS_AGE
    if unit is None and size >= _LATEST:
        fit = [one for one, power in UNITS.items() if power and low < first.scaleb(power) < high]
        if not fit:
            raise ArgumentError(
                f"{place(0)}: {column} starts at {float(first):.6g}, which is after the year 5138 "
                'if it counts seconds: say unit="ms" (--unit ms) of a switching log (or us, ns; s '
                "if it does count seconds), or count seconds from the first row."
            )
        unit = fit[0]
    power = UNITS[unit or "s"]
    since_1970 = low < first.scaleb(power) < high
    if since_1970 or power:
        called = {"s": "s", "ms": "ms", "us": "µs", "ns": "ns"}[unit or "s"]
        notation = f"times in {called}"
        notation += f" since 1970, from {_date(first.scaleb(power))}" if since_1970 else ""
    seconds = np.array([float((value - first).scaleb(power)) for value in values])
    own = float(first.scaleb(power)) if size < _LATEST and not notation else 0.0
    return RowClock(seconds, own, notation, Decimal(1).scaleb(power), first)


def require_rising(
    seconds: Float[np.ndarray, " row"],
    same: Callable[[int, int], bool],
    place: Callable[[int], str],
    column: str,
    shown: Sequence[object],
) -> list[int]:
    """The rows to keep: all but repeated ones; refuses times that go back.

    same : whether two rows have the same cells; shown : cells of the times
    """
    if (seconds[1:] > seconds[:-1]).all():
        return list(range(len(seconds)))
    kept, times = [0], seconds.tolist()
    for row in range(1, len(times)):
        last = kept[-1]
        if times[row] > times[last]:
            kept.append(row)
        elif times[row] != times[last] or not same(last, row):
            back = times[last] - times[row]
            hint = "sort the log and keep one row per instant"
            if abs(back - _HOUR) < 0.1 * _HOUR:
                hint += "; of a clock set back from summer time write stamps with their zones"
            raise ArgumentError(
                f"{place(row)}: {column} must be later than in {place(last).split(', ')[-1]}, got "
                f"{shown[row]!s:.40} after {shown[last]!s:.40}: {hint}."
            )
    return kept


def _looks_like_a_stamp(cell: str) -> bool:
    return ":" in cell or bool(re.search(r"\d[-/.]\w+[-/.]\d", cell) or _COMPACT.match(cell))


def _decimal(name: str, text: str) -> Decimal:
    """The number in a cell, with all of its digits."""
    try:
        value = Decimal(text)
    except InvalidOperation:
        got = repr(text) if len(repr(text)) <= 80 else f"{repr(text)[:79]}…"
        raise ArgumentError(
            f"{name} must be a number or a stamp such as 2026-03-02 08:15:00.5, got {got}: leave "
            "out lines that are no samples, or say which column holds the times by time=, --time."
        ) from None
    if not (value.is_finite() and isfinite(float(value))):
        raise ArgumentError(f"{name} must be finite, got {text:.40}.")
    return value


class _Stamp(NamedTuple):
    """Its date, the time of day in seconds, and the offset of its zone, None without one."""

    date: str
    seconds: Decimal
    zone: int | None


def _stamped(cells: Sequence[str], place: Callable[[int], str], column: str) -> RowClock:
    stamps = [_stamp(cell, f"{place(row)}: {column}") for row, cell in enumerate(cells)]
    zoned = [stamp.zone is not None for stamp in stamps]
    if any(zoned) and not all(zoned):
        row = zoned.index(not zoned[0])
        raise ArgumentError(
            f"{place(row)}: {column} must have a zone in all rows or in none, got {cells[row]!r} "
            f"after {cells[row - 1]!r}."
        )
    dates = sorted({stamp.date for stamp in stamps})
    if dates == [""]:
        return _times_of_day(stamps)
    found = []
    for form, called in _DATES.items():
        if _day(dates[0], form) is None:
            continue
        days = {date: _day(date, form) for date in dates}
        if None not in days.values():
            values = [
                days[date] * _DAY + seconds - (zone or 0)  # pyright: ignore[reportOptionalOperand]
                for date, seconds, zone in stamps
            ]
            found.append((called, values))
    if not found:
        odd = next((row for row, one in enumerate(stamps) if _unknown(one.date)), None)
        row = 0 if odd is None else odd
        raise ArgumentError(
            f"{place(row)}: {column} must be a number or a stamp such as 2026-03-02 08:15:00.5, "
            f"in one notation throughout, got {cells[row]!r}: write it so, or count seconds."
        )
    called, values = _chosen(found, cells, place, column)
    seconds = np.array([float(value - values[0]) for value in values])
    time = "" if all(stamp.seconds == 0 for stamp in stamps) else " hh:mm:ss"
    zone = " UTC" if zoned[0] else ""
    notation = f"times {called}{time} from {_date(values[0])}{zone}" if called else _ONE_DAY
    return RowClock(seconds, 0.0, notation, origin=values[0])


def _chosen(
    found: list[tuple[str, list[Decimal]]],
    cells: Sequence[str],
    place: Callable[[int], str],
    column: str,
) -> tuple[str, list[Decimal]]:
    """The notation in which time does not go back, nor jump by days where another has no jump.

    "" if it does not matter, as all rows are of one day.
    """
    steps = [np.diff(np.array([float(v - values[0]) for v in values])) for _, values in found]
    rising = [i for i, own in enumerate(steps) if (own >= 0.0).all()]
    if not rising:
        return found[0]
    first = found[rising[0]]
    if all((steps[i] == steps[rising[0]]).all() for i in rising):
        return ("", first[1]) if len(rising) > 1 else first
    whole = [
        i for i in rising if steps[i].max() <= _CONTINUOUS * max(float(np.median(steps[i])), 1e-9)
    ]
    if len(whole) == 1:
        return found[whole[0]]
    both = " and ".join(found[i][0] for i in rising[:2])
    raise ArgumentError(
        f"{place(0)}: {column} is {cells[0]!r}, and the dates of the log may be {both}: write them "
        "as yyyy-mm-dd, or give a table with stamps: "
        f'frame["{column}"] = pandas.to_datetime(frame["{column}"], dayfirst=True).'
    )


def _times_of_day(stamps: Sequence[_Stamp]) -> RowClock:
    """Times without dates, midnight passed where they go back by half a day."""
    days, values, midnights = 0, [], 0
    for stamp in stamps:
        value = stamp.seconds - (stamp.zone or 0) + days * _DAY
        if values and values[-1] - value > _DAY // 2:
            days, midnights = days + 1, midnights + 1
            value += _DAY
        values.append(value)
    seconds = np.array([float(value - values[0]) for value in values])
    notation = _ONE_DAY
    if midnights:
        notation = (
            f"times hh:mm:ss, midnight passed {midnights} times"
            if midnights > 1
            else ("times hh:mm:ss, midnight passed once")
        )
    return RowClock(seconds, 0.0, notation, origin=values[0])


def _stamp(cell: str, name: str) -> _Stamp:
    if match := _COMPACT.fullmatch(cell):
        cell = f"{match[1]} {match[2]}:{match[3]}:{match[4]}{match[5]}"
    match = _TIME_OF_DAY.fullmatch(cell)
    if match is None or (match["hour"] is None and not re.search(r"\d\D\w+\D\d|^\d{8}$", cell)):
        raise ArgumentError(
            f"{name} must be a number or a stamp such as 2026-03-02 08:15:00.5, got {cell!r:.80}."
        )
    date = match["date"].strip().rstrip("T").strip().rstrip(",")
    if match["hour"] is None:
        return _Stamp(date, Decimal(0), None)
    hour, minute, second = (int(match[part] or 0) for part in ("hour", "minute", "second"))
    text, zone = match["zone"].strip(), None
    if text.lower().replace(".", "") in ("am", "pm"):
        hour = hour % 12 + 12 * (text[0] in "pP")
    elif text.upper() in ("Z", "UTC", "GMT"):
        zone = 0
    elif offset := _ZONE.fullmatch(text.removeprefix("UTC").removeprefix("GMT")):
        size = int(offset[2]) * _HOUR + int(offset[3] or 0) * 60
        zone = size if offset[1] == "+" else -size
    elif text:
        raise ArgumentError(
            f"{name} must have a zone such as +01:00 or Z, or none, got {text!r:.40}: write the "
            "offset from UTC."
        )
    if minute > 59 or second > 60:
        raise ArgumentError(f"{name} must be a time of day, got {cell!r:.80}.")
    days = re.fullmatch(r"(\d+) days?", date)  # durations, as pandas writes them
    if days:
        date, hour = "", hour + 24 * int(days[1])
    fraction = Decimal(f"0.{match['fraction'] or 0}")
    return _Stamp(date, hour * _HOUR + minute * 60 + second + fraction, zone)


def _day(date: str, form: str) -> int | None:
    try:
        day = datetime.strptime(date, form)
    except ValueError:
        return None
    return (day - datetime(1970, 1, 1)).days if 1900 <= day.year <= 2200 else None


def _unknown(date: str) -> bool:
    return all(_day(date, form) is None for form in _DATES)


def _date(seconds: Decimal) -> str:
    return str(datetime(1970, 1, 1, tzinfo=UTC) + timedelta(seconds=float(seconds)))[:19]
