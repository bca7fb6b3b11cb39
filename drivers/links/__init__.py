"""Thin wrappers around transport libraries; the only place where those libraries are imported."""
