"""`vergence reproduce`: the article's experiments, one module each, and the article's figures.

Every experiment is a module with these parts, in this order:

- its configuration, a dataclass with a default for every field, and `run(config, seed, mapper)`,
  which returns one tidy table;
- `summarise`, the article's figures beside ours with verdicts, and `numbers`, the numbers that the
  text fills in;
- `draw`, the figures by name;
- `EXPERIMENT`, with its name, its title, its place in the article, the fields that `--quick`
  changes, and the functions above.

The text of its section in the report is a template of the same name in `sections`.

To add an experiment, make such a module and name it in `vergence.eval.article.config.EXPERIMENTS`.
`run` gives the mapper independent, picklable jobs. Their randomness comes from `job_rng` or from
the streams of the plants, so the table is the same wherever they run. Code judges only in the
column of verdicts. The text is written by a person: it states our numbers beside the article's, in
sentences that hold for any numbers. `docs/reproduce.md` interprets them; its numbers are tested.
"""
