"""`vergence reproduce`: the article's experiments, one folder each, and the article's figures.

Every experiment is a folder with these files, to be read in this order:

- `experiment.py`: `EXPERIMENT`, with its name, its title, its place in the article, the fields that
  `--quick` changes, and the functions of the other files;
- `trials.py`: its configuration, a dataclass with a default for every field, and
  `run(config, seed, mapper)`, which returns one tidy table;
- `findings.py`: `summarise`, the article's figures beside ours with verdicts, and `numbers`, the
  numbers that the text fills in;
- `figures.py`: `draw`, the figures by name;
- `section.jinja`: the text of its section in the report.

To add an experiment, make such a folder and name it in
`vergence.eval.article.registry.EXPERIMENTS`. `run` gives the mapper independent, picklable jobs.
Their randomness comes from `job_rng` or from the streams of the plants, so the
table is the same wherever they run. Code judges only in the column of verdicts. The text is written
by a person: it states our numbers beside the article's, in sentences that hold for any numbers.
`docs/reproduce.md` interprets them; its numbers are tested.
"""
