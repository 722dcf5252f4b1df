"""The command line, scenes, session loop and everything that touches files."""
