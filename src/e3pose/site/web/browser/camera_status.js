// What a camera reports: types and meanings of its fields, made of `CameraStatus`.
// `python docs/hooks.py` writes this file.

/**
 * @typedef {object} CameraStatus
 * @property {string} camera_id the camera
 * @property {boolean} online whether it can be selected
 * @property {string} why reason if it cannot be selected; otherwise a warning
 * @property {"active"|"aggressive-power-saving"|"asleep"|"power-saving"|"suspended"|null} mode last reported mode; null before the first
 * @property {string} title what people call it; by default its id
 * @property {number} duty share of the last minute's slots in which it was selected, blind slots left out
 * @property {number|null} power_w reported power; null if unknown
 * @property {boolean} measured whether the power is measured; otherwise a model estimates it
 * @property {number|null} cpu_s processor time of its program since it started to capture; null if unknown
 * @property {number|null} cpu_saved processor time saved, as a share of that of activity in every slot; null while too little is known
 * @property {number|null} battery remaining charge, 0 to 1; null on mains or if unknown
 * @property {boolean} gauge whether the charge comes from a gauge, not a model
 * @property {number} deficit energy-deficit queue: what it spent beyond its budget so far, in slots
 * @property {number|null} last_seen_s seconds since its last message; null if never
 * @property {number} late views that arrived after their slot was closed
 * @property {number} lost ordered views that never arrived
 * @property {number} ordered views ordered in time since the edge started
 * @property {number|null} delivered share of the newest ordered views that arrived in time; null while they are too few
 * @property {number} clock_offset_ms edge time minus camera time
 * @property {number|null} noise_factor learned sigma of its keypoints over that of the noise model; null if unknown
 * @property {number|null} occlusion predicted overlap of the people in its view in the slot decided last, eq. (4); null if unknown
 * @property {number|null} gain_nats expected information per joint that its view adds to the other cameras; null if the policy does not use it
 * @property {number|null} price what selecting it costs, on the scale of the information: grows with its deficit; null if the policy does not use it
 * @property {number|null} temperature_c hottest sensor of the device, degrees Celsius; null without one
 * @property {boolean} paused whether an operator paused it
 * @property {number|null} budget share of slots in which it may be active, as a mean
 * @property {number|null} turned_deg by how much, at least, it was turned since it was calibrated; null if it stands as calibrated, as far as can be seen
 * @property {number} focused frames it processed with feedback since it started
 * @property {number|null} source_fps frames per second that its source brings, measured; null if unknown
 * @property {number|null} asleep_s seconds until it is expected back from an ordered sleep; negative while it oversleeps, null while it is awake
 * @property {number|null} wake_s seconds it takes to wake, mean as learned; null before its first wake
 * @property {number|null} unchanged share of its looks in which its image was unchanged, so that the network did not run; null without any
 */

export const MEANINGS = {
  "camera_id": "the camera",
  "online": "whether it can be selected",
  "why": "reason if it cannot be selected; otherwise a warning",
  "mode": "last reported mode; – before the first",
  "title": "what people call it; by default its id",
  "duty": "share of the last minute's slots in which it was selected, blind slots left out",
  "power_w": "reported power; – if unknown",
  "measured": "whether the power is measured; otherwise a model estimates it",
  "cpu_s": "processor time of its program since it started to capture; – if unknown",
  "cpu_saved": "processor time saved, as a share of that of activity in every slot; – while too little is known",
  "battery": "remaining charge, 0 to 1; – on mains or if unknown",
  "gauge": "whether the charge comes from a gauge, not a model",
  "deficit": "energy-deficit queue: what it spent beyond its budget so far, in slots",
  "last_seen_s": "seconds since its last message; – if never",
  "late": "views that arrived after their slot was closed",
  "lost": "ordered views that never arrived",
  "ordered": "views ordered in time since the edge started",
  "delivered": "share of the newest ordered views that arrived in time; – while they are too few",
  "clock_offset_ms": "edge time minus camera time",
  "noise_factor": "learned sigma of its keypoints over that of the noise model; – if unknown",
  "occlusion": "predicted overlap of the people in its view in the slot decided last, eq. (4); – if unknown",
  "gain_nats": "expected information per joint that its view adds to the other cameras; – if the policy does not use it",
  "price": "what selecting it costs, on the scale of the information: grows with its deficit; – if the policy does not use it",
  "temperature_c": "hottest sensor of the device, degrees Celsius; – without one",
  "paused": "whether an operator paused it",
  "budget": "share of slots in which it may be active, as a mean",
  "turned_deg": "by how much, at least, it was turned since it was calibrated; – if it stands as calibrated, as far as can be seen",
  "focused": "frames it processed with feedback since it started",
  "source_fps": "frames per second that its source brings, measured; – if unknown",
  "asleep_s": "seconds until it is expected back from an ordered sleep; negative while it oversleeps, – while it is awake",
  "wake_s": "seconds it takes to wake, mean as learned; – before its first wake",
  "unchanged": "share of its looks in which its image was unchanged, so that the network did not run; – without any"
};
