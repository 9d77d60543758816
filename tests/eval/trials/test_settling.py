"""The names of the columns that tell of a band of settling."""

from hypothesis import given
from hypothesis import strategies as st

from vergence.eval.trials.settling import Band

PIXELS = (
    st.floats(1e-6, 1e6) | st.integers(1, 100).map(float) | st.integers(1, 99).map((0.1).__mul__)
)


@given(PIXELS, PIXELS)
def test_two_bands_never_share_a_column(one, other):
    assert one == other or Band(one).settle_s != Band(other).settle_s


def test_the_columns_of_published_tables_keep_their_names():
    half, one, two = Band(0.5), Band(1.0), Band(2.0)
    assert [band.settle_s for band in (half, one, two)] == [
        "settle_05px_s", "settle_1px_s", "settle_2px_s",
    ]  # fmt: skip
    assert (one.bound_s, one.ratio_p95, one.settled_fraction, one.settle_median_s) == (
        "bound_s", "ratio_to_bound_p95", "settled_fraction", "settle_1px_median_s",
    )  # fmt: skip
    assert (two.bound_s, two.ratio_p95, two.settled_fraction, two.settle_median_s) == (
        "bound_2px_s", "ratio_to_bound_2px_p95", "settled_2px_fraction", "settle_2px_median_s",
    )  # fmt: skip
