"""File formats that do not depend on a controller: conversion of text to values and of values to text. The caller reads
and writes the files."""
