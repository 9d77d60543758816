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
    names = ("settle_s", "bound_s", "ratio_p95", "settled_fraction", "settle_median_s")
    found = {
        size: [getattr(SettlingBand(size), f"{name}_column") for name in names]
        for size in (1.0, 2.0)
    }
    assert found == {
        1.0: ["settle_1px_s", "bound_s", "ratio_to_bound_p95", "settled_fraction",
              "settle_1px_median_s"],
        2.0: ["settle_2px_s", "bound_2px_s", "ratio_to_bound_2px_p95", "settled_2px_fraction",
              "settle_2px_median_s"],
    }  # fmt: skip
    assert SettlingBand(0.5).settle_s_column == "settle_05px_s"
