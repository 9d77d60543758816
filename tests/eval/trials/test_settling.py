"""The names of the columns that tell of a band of settling."""

from hypothesis import given
from hypothesis import strategies as st

from vergence.eval.trials.settling import SettlingBand

PIXELS = (
    st.floats(1e-6, 1e6) | st.integers(1, 100).map(float) | st.integers(1, 99).map((0.1).__mul__)
)


@given(PIXELS, PIXELS)
def test_two_bands_never_share_a_column(one, other):
    assert one == other or SettlingBand(one).settle_s_column != SettlingBand(other).settle_s_column


def test_the_columns_of_published_tables_keep_their_names():
    half, one, two = SettlingBand(0.5), SettlingBand(1.0), SettlingBand(2.0)
    assert [band.settle_s_column for band in (half, one, two)] == [
        "settle_05px_s", "settle_1px_s", "settle_2px_s",
    ]  # fmt: skip
    assert (
        one.bound_s_column, one.ratio_p95_column, one.settled_fraction_column,
        one.settle_median_s_column,
    ) == (
        "bound_s", "ratio_to_bound_p95", "settled_fraction", "settle_1px_median_s",
    )  # fmt: skip
    assert (
        two.bound_s_column, two.ratio_p95_column, two.settled_fraction_column,
        two.settle_median_s_column,
    ) == (
        "bound_2px_s", "ratio_to_bound_2px_p95", "settled_2px_fraction", "settle_2px_median_s",
    )  # fmt: skip
