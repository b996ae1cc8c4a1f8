"""What a study says of its figures beside what the tables of all studies say."""

from studies.accuracy_cost.results import Results, key_of
from studies.accuracy_cost.studies import DEFAULT
from studies.accuracy_cost.study import Study

__all__ = ["remarks"]


def remarks(study: Study, results: Results) -> list[str]:
    """Paragraphs of Markdown, for the page; most studies have none."""
    if study.name != "mapping":
        return []
    # Only this study is asked, and its scenes take a second to import.
    from studies.accuracy_cost.mapping.promise import sentences  # noqa: PLC0415

    default = key_of(DEFAULT, study.dives[0]).setting
    dives = {
        dive.name: {
            DEFAULT.key if key.setting == default else key.setting: figures
            for key, figures in results.rows.items()
            if (key.dive, key.seed) == (dive.name, dive.seed)
        }
        for dive in study.dives
    }
    return [PROMISE, sentences(dives)]


PROMISE = """\
What was promised beside the published settings: at equal error 10 times less time, and in equal
time half the error. Equal error is reached by the cheapest of all settings above with no more
error, equal time by the one of least error in no more time. Why it is not kept: most of the error
is the echo's elevation, which no ping tells, and `rays` looks at a part of the ping alone
([mapping.md](../concepts/mapping.md#three-profiles)). Below it, how far the log-odds of each
integrator are off from those of the converged map, in natural units."""
