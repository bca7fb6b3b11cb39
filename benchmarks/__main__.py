"""Command `make bench`, which runs all benchmarks one after the other on one computer."""

from __future__ import annotations

from benchmarks import design, engine, family, field, history, identification, route, sequential, timing


def main() -> None:
    for part in (field, family, identification, engine, timing, route, design, sequential, history):
        print(f"\n{(part.__doc__ or part.__name__).splitlines()[0]}")
        part.main()


if __name__ == "__main__":
    main()
