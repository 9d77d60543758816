"""`vergence reproduce`: the article's experiments, a folder each, and what the article states.

Every experiment is a folder of the same files, to be read in this order:

- `experiment.py`: `EXPERIMENT`, its name and title, where the article has it, what `--quick`
  changes, and the functions of the other files;
- `trials.py`: its configuration, a dataclass with a default for every field, and
  `run(config, seed, mapper)`, which returns one tidy table;
- `findings.py`: `summarise`, the article's figures beside ours with verdicts, and `numbers`, what
  the text fills in;
- `figures.py`: `draw`, the figures by name;
- `section.jinja`: the text of its section in the report.

To add one: make such a folder and name it in `vergence.eval.article.experiment.EXPERIMENTS`; one
that needs a layer above lies there, as `vergence.calibration.head.article` does. `run`
gives the mapper independent, picklable jobs, whose randomness comes from `job_rng` or from the
streams of the plants, so that the table is the same wherever they run. Code judges only in the
column of verdicts. The text is written by a person: it states numbers beside those of the article
and chooses no words, so that it is true whatever the numbers are. What they mean is said in
`docs/reproduce.md`, whose numbers are tested.
"""
