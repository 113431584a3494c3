"""What a log's meta.json may hold, as types; a laboratory's own keys may stand beside them."""

from __future__ import annotations

from typing import Annotated, Any

from msgspec import Meta, Struct

Positive = Annotated[float, Meta(gt=0, le=1e100)]
Run = Annotated[int, Meta(ge=-(2**53), le=2**53)]


class MetaRecord(Struct):
    """Facts about a campaign; everything is optional, null is absent."""

    case_id: str | None = None
    device: str | None = None
    family: str | None = None
    base_model: str | None = None
    nominal: dict[str, Any] = {}
    probes: list[dict[str, Any]] | None = None
    validation_runs: list[Run] = []
    gap_metric: str | None = None
    gap_length_scale_m: Positive | None = None
    gap_threshold_rel: Positive | None = None
    sampling_clock_s: Positive | None = None
    noise_1sigma: dict[str, Positive] = {}
    counts_per_turn: Annotated[float, Meta(ge=2, le=1e100)] | None = None
