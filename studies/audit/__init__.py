"""An audit of a run's folder, from what was recorded and what was made of it.

It is written apart from the code that it judges: it reads the recording with the reader of the MCAP
package and its messages as plain JSON, and counts members, steps and cycles by itself.
"""
