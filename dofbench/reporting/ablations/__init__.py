"""Ablation tables: declared rows of options, run over datasets and seeds, shown beside published figures."""
