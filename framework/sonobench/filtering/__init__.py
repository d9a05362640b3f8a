"""Pure filtering maths on arrays that several trackers, motions and births share."""
