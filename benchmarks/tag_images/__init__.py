"""How often and how exactly detectors find AprilTags in photographs, varied in known ways.

Run ``python -m benchmarks.tag_images FOLDER``, with ``--json FILE`` and ``--csv FILE`` to keep the
tables. The folder holds photographs, each with a text file of the same name that lists its tags as
the AprilTag library's own tests do; see `benchmarks.tag_images.photographs`. Every tag is cut out
with what surrounds it and turned, tilted, shrunk, blurred, shaded and so on, by
`benchmarks.tag_images.variations`, and all methods of `benchmarks.tag_images.methods` whose package
is installed look for it; `benchmarks.tag_images.scores` says what counts as found.

The corners of the text files are the AprilTag library's own findings, and no truth. Errors are
therefore measured against the median of what the methods find in the unvaried photograph at full
size, carried over to the varied image by its exact mapping. All bindings of the AprilTag library
have one vote together, or they would outvote all others; OpenCV's default, whose corners are whole
pixels, has none. Where fewer than two vote, the text file counts. A median is no truth either: a
method that votes is favoured by the errors that it repeats in the variation, most where the
variation is weak. Compare methods that vote with each other, and look at the strong variations.
"""
