"""Variations of the table, in the order of its rows."""

from benchmarks.tag_images.variations import (
    Variation,
    blurred,
    compressed,
    dimmed,
    noisy,
    ramped,
    shaded,
    shrunk,
    smeared,
    still,
    tilted,
    turned,
)

AS_IT_IS = Variation("as it is", quick=True)

VARIATIONS: tuple[Variation, ...] = (
    AS_IT_IS,
    Variation("shifted by part of a pixel", still),
    *(
        Variation(f"turned {angle} deg", turned(angle), quick=angle == 30)
        for angle in (10, 30, 45, 80)
    ),
    *(
        Variation(f"tilted {angle} deg", tilted(angle), quick=angle == 60)
        for angle in (30, 45, 60, 70)
    ),
    *(
        Variation(f"edge {edge} px", shrunk(edge), least_edge_px=edge, quick=edge in (20, 14))
        for edge in (40, 28, 20, 16, 14)
    ),
    *(
        Variation(f"blur {sigma:g} px", None, (blurred(sigma),), quick=sigma == 1.5)
        for sigma in (0.7, 1.0, 1.5, 2.0, 3.0)
    ),
    *(
        Variation(f"motion {length} px", None, (smeared(length),), quick=length == 5)
        for length in (3, 5, 8, 12)
    ),
    *(
        Variation(f"noise {sigma}", None, (noisy(sigma),), quick=sigma == 20)
        for sigma in (5, 10, 20, 40)
    ),
    *(Variation(f"dimmed to {share}", None, (dimmed(share),)) for share in (0.5, 0.2)),
    *(
        Variation(f"ramp down to {share}", None, (ramped(share),), quick=share == 0.2)
        for share in (0.5, 0.2)
    ),
    *(
        Variation(f"half in shadow of {share}", None, (shaded(share),), quick=share == 0.5)
        for share in (0.7, 0.5, 0.3)
    ),
    *(
        Variation(f"half in soft shadow of {share}", None, (shaded(share, 0.5),))
        for share in (0.5, 0.3)
    ),
    *(
        Variation(f"JPEG {quality}", None, (compressed(quality),), quick=quality == 15)
        for quality in (60, 30, 15, 8)
    ),
    Variation(
        "turned 30 deg, blur 1 px, noise 10", turned(30), (blurred(1.0), noisy(10.0)), quick=True
    ),
    Variation("edge 20 px, noise 10, JPEG 50", shrunk(20), (noisy(10.0), compressed(50)), 20.0),
    Variation("edge 20 px, motion 3 px, noise 5", shrunk(20), (smeared(3.0), noisy(5.0)), 20.0),
    Variation("edge 16 px, blur 0.7 px", shrunk(16), (blurred(0.7),), 16.0),
    Variation(
        "tilted 45 deg, motion 3 px, ramp down to 0.3", tilted(45), (smeared(3.0), ramped(0.3))
    ),
    Variation("edge 28 px, tilted 60 deg, noise 5", shrunk(28, tilted(60)), (noisy(5.0),), 28.0),
    Variation(
        "half in shadow of 0.7, noise 10, JPEG 50",
        None,
        (shaded(0.7), noisy(10.0), compressed(50)),
        quick=True,
    ),
    Variation("dimmed to 0.2, noise 5, blur 1 px", None, (dimmed(0.2), blurred(1.0), noisy(5.0))),
)
