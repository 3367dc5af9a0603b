"""Looking at what was trained: camera paths, films, and single photographs refocused."""
