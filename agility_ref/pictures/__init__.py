"""Pictures: recorded episodes, learning curves, strobe pictures, maps, films and the live view.

Everything that is drawn; imports from the core and from training.
In: a policy and an environment, or what a run has written.  Out: figures, films, a page, a window.
"""
