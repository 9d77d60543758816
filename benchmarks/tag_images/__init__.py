"""Compare detection rates and accuracies of AprilTag detectors on varied photographs.

Run ``python -m benchmarks.tag_images FOLDER``, with ``--json FILE`` and ``--csv FILE`` to keep the
tables. The folder holds photographs, each with a text file of the same name that lists its tags as
the AprilTag library's own tests do; see `benchmarks.tag_images.photographs`. Every tag is cut out
with its surroundings and rotated, tilted, shrunk, blurred, shaded and so on, by
`benchmarks.tag_images.variations`. All methods of `benchmarks.tag_images.methods` whose package is
installed then detect it; `benchmarks.tag_images.scores` defines a detection.

The corners of the text files are results of the AprilTag library, not ground truth. Errors are
therefore measured against the median of the methods' results in the unvaried photograph at full
size, mapped exactly to the varied image. All bindings of the AprilTag library share one vote, so
that they do not outvote the others. OpenCV's default, whose corners are whole pixels, has no vote.
If fewer than two methods vote, the text file is used. The median is no ground truth either: it
favours a voting method that repeats its own errors in the variation, most if the variation is
weak. Compare methods that vote with each other, and prefer the strong variations.
"""
