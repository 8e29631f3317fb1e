"""Prints sentences, their lengths and the broken rules by kind of text: ``python -m prose.counts [FOLDER]``."""

from __future__ import annotations

import sys
from collections import Counter
from pathlib import Path

from prose.check import ROOT
from prose.rules import load, mean, read


def main(root: Path) -> None:
    """Print the table of the texts below a checkout's folder."""
    rules = load()
    print("| text | sentences | mean words | longest | over 30 words | over 35 words | broken rules |")
    print("|---|---|---|---|---|---|---|")
    broken: dict[str, Counter[str]] = {}
    for kind in rules.kinds:
        sentences = [sentence for path in kind.paths(root) for sentence in read(path)]
        if not sentences:
            continue
        words = [sentence.words for sentence in sentences]
        broken[kind.name] = Counter(
            rule.name for s in sentences for rule in rules.rules if rule.reads(s.path) and rule.hits(s.text)
        )
        row = (
            len(words),
            f"{mean(sentences):.1f}",
            max(words),
            sum(n > 30 for n in words),
            sum(n > 35 for n in words),
            broken[kind.name].total(),
        )
        print(f"| {kind.name} | {' | '.join(map(str, row))} |")
    for name, counts in broken.items():
        rules_of_kind = ", ".join(f"{rule} {number}" for rule, number in counts.most_common())
        print(f"\n{name}: {rules_of_kind or 'no rule broken'}")


if __name__ == "__main__":
    main(Path(sys.argv[1]).resolve() if len(sys.argv) > 1 else ROOT)
