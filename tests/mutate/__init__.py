"""Mutations: one-line faults put into the product on purpose, each of which the tests that are named with it must notice.

    python -m tests.mutate                             all tables, one mutation after the other
    python -m tests.mutate --area spawn --jobs 2       one table, two at a time
    python -m tests.mutate --only spawn:3              one mutation
    python -m tests.mutate --record                    with a dated record in notebooks/records

A table is a file of this folder with a list MUTATIONS (`mutation`). The checkout is never changed: tests run in copies of it
(`copies`), first as it is, where they must pass, then with each mutation (`runner`). A mutation is killed if its tests fail,
and survives if they pass: then the promise that it breaks is tested by nothing. What cannot tell is an error: text that is not
there exactly once, a change of comments alone, code that does not compile, tests that fail without it, are skipped, or do not
end.
"""
