"""Thin wrappers around transport libraries; no other package imports those libraries."""
