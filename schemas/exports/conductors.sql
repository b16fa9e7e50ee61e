-- Conductors of spans as flights measured them, each beside the straight line between the structures.
WITH scaled AS (
    SELECT *,
           -- metres of the WGS 84 ellipsoid in a degree
           111132.954 - 559.822 * cos(2 * radians(from_lat_deg)) + 1.175 * cos(4 * radians(from_lat_deg)) AS north_scale,
           111412.84 * cos(radians(from_lat_deg)) - 93.5 * cos(3 * radians(from_lat_deg)) AS east_scale
    FROM spans
),
directed AS (
    SELECT *,
           (to_lat_deg - from_lat_deg) * north_scale AS north_m,
           (to_lon_deg - from_lon_deg) * east_scale AS east_m
    FROM scaled
),
moved AS ( -- degrees for a metre to the left
    SELECT *, east_m / sqrt(north_m ** 2 + east_m ** 2) / north_scale AS left_lat_deg,
           -north_m / sqrt(north_m ** 2 + east_m ** 2) / east_scale AS left_lon_deg
    FROM directed
)
SELECT k.*, m.line_id, m.from_structure, m.to_structure, m.asset_id, m.mrid,
       m.from_lat_deg + k.across_m * m.left_lat_deg AS from_lat_deg,
       m.from_lon_deg + k.across_m * m.left_lon_deg AS from_lon_deg,
       m.from_height_m + k.raised_m AS from_height_m,
       m.to_lat_deg + k.across_m * m.left_lat_deg AS to_lat_deg,
       m.to_lon_deg + k.across_m * m.left_lon_deg AS to_lon_deg,
       m.to_height_m + k.raised_m AS to_height_m
FROM conductors AS k
JOIN moved AS m USING (span_id)
WHERE k.flight_id IN (SELECT unnest($flight_ids))
ORDER BY k.flight_id, m.line_id, k.span_id, k.channel_id, k.conductor
