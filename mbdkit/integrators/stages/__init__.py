"""Stages of one-step methods: tableaux, stage equations and their solution."""
