"""What claims, bounds, verdicts, methods and messages mean: one page an id, for engineers who have not read the papers.

The Markdown files beside this one hold the pages: `## ` with the ids in backquotes, a line with the kinds, then what it
is, why it is so, and what to do next.
"""
