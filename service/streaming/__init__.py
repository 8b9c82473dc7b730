"""Streams: a session as a state machine without I/O, and what it computes with.

The way of the audio: ``buffer`` (bounded, oldest dropped) → ``pcm`` (samples) → ``pipeline``
(resample, STFT, localize, track) → ``outcome`` → ``session`` (messages). Everything but the pipeline
is cheap and runs on the event loop; the pipeline runs in a worker thread, one step at a time.
"""
