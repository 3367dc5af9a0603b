"""The dataset folder and the synthesis of datasets."""
