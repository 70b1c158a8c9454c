"""The command line: one function per command of ``agility-ref``, over everything else.

Each command imports what it needs when it is called, so that ``--help`` waits for nothing.
In: words typed in a shell.  Out: text, files, exit status 0, 1, 2 or 130.
"""
