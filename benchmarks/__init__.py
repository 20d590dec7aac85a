"""Benchmarks of the solving methods: ``python -m benchmarks``; ``docs/benchmarks.md`` explains."""
