"""What the bundled distribution registers; targets are strings, so that listing them imports none of them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from sonobench.hookspecs import hookimpl

_HERE = "sonobench_plugins"


def _gaussian_phd(transform: str) -> dict[str, Any]:
    return {"use": "gm-phd", "transform": {"use": transform}}


@hookimpl
def sonobench_components() -> Mapping[str, Mapping[str, Any]]:
    return {
        "front_end": {
            "gcc-max": f"{_HERE}.front_end.gcc_max:GccMax",
            "gcc-peaks": f"{_HERE}.front_end.gcc_peaks:GccPeaks",
            "srp-peaks": f"{_HERE}.front_end.srp_peaks:SrpPeaks",
            "recorded": f"{_HERE}.front_end.recorded:Recorded",
            "avs": f"{_HERE}.front_end.avs:Avs",
        },
        "preprocessor": {
            "pre-filter": f"{_HERE}.preprocessor.pre_filter:PreFilter",
            "pre-emphasis": f"{_HERE}.preprocessor.pre_emphasis:PreEmphasis",
            "normalise": f"{_HERE}.preprocessor.normalise:Normalise",
            "noise-reduction": f"{_HERE}.preprocessor.noise_reduction:NoiseReduction",
        },
        "delay": {
            "cc": f"{_HERE}.delay.cc:Cc",
            "roth": f"{_HERE}.delay.roth:Roth",
            "scot": f"{_HERE}.delay.scot:Scot",
            "phat": f"{_HERE}.delay.phat:Phat",
            "ht": f"{_HERE}.delay.ht:Ht",
            "rho-phat": f"{_HERE}.delay.rho_phat:RhoPhat",
            "iphat": f"{_HERE}.delay.iphat:Iphat",
            "subtracted-phat": f"{_HERE}.delay.subtracted_phat:SubtractedPhat",
            "selected-phat": f"{_HERE}.delay.selected_phat:SelectedPhat",
            "diffuse-masked-phat": f"{_HERE}.delay.diffuse_masked_phat:DiffuseMaskedPhat",
        },
        "activity": {
            "energy": f"{_HERE}.activity.energy:Energy",
            "short-time-energy": f"{_HERE}.activity.short_time_energy:ShortTimeEnergy",
            "always": f"{_HERE}.activity.always:Always",
        },
        "motion": {
            "langevin": f"{_HERE}.motion.langevin:Langevin",
            "constant-velocity": f"{_HERE}.motion.constant_velocity:ConstantVelocity",
            "coordinated-turn": f"{_HERE}.motion.coordinated_turn:CoordinatedTurn",
            "random-walk": f"{_HERE}.motion.random_walk:RandomWalk",
            "adaptive-langevin": f"{_HERE}.motion.adaptive_langevin:AdaptiveLangevin",
            "adaptive-constant-velocity": f"{_HERE}.motion.adaptive_constant_velocity:AdaptiveConstantVelocity",
            "bearing-velocity": f"{_HERE}.motion.bearing_velocity:BearingVelocity",
            "bearing-acceleration": f"{_HERE}.motion.bearing_acceleration:BearingAcceleration",
            "bearing-turn": f"{_HERE}.motion.bearing_turn:BearingTurn",
            "imm": f"{_HERE}.motion.imm:Imm",
        },
        "measurement": {
            "tdoa": f"{_HERE}.measurement.tdoa:Tdoa",
            "tdoa-images": f"{_HERE}.measurement.tdoa_images:TdoaImages",
            "position": f"{_HERE}.measurement.position:Position",
            "direction": f"{_HERE}.measurement.direction:Direction",
        },
        "likelihood": {
            "multi-feature": f"{_HERE}.likelihood.multi_feature:MultiFeature",
            "tdoa-field": f"{_HERE}.likelihood.tdoa_field:TdoaField",
            "direction-spectrum": f"{_HERE}.likelihood.direction_spectrum:SpectrumLikelihood",
            "fitted-detection": f"{_HERE}.likelihood.fitted_detection:FittedDetection",
        },
        "direction": {
            "intensity": f"{_HERE}.direction.intensity:Intensity",
            "maximum-power": f"{_HERE}.direction.maximum_power:MaximumPower",
            "maximum-power-exact": f"{_HERE}.direction.maximum_power_exact:MaximumPowerExact",
            "wpf-mp": f"{_HERE}.direction.wpf_mp:WpfMp",
            "capon": f"{_HERE}.direction.capon:Capon",
            "music": f"{_HERE}.direction.music:Music",
            "cumulant-peaks": f"{_HERE}.direction.cumulant_peaks:CumulantPeaks",
            "covariance-peaks": f"{_HERE}.direction.covariance_peaks:CovariancePeaks",
            "gls": f"{_HERE}.direction.gls:Gls",
            "cumulant-gls": {"use": "gls", "noise": "any"},
        },
        "spectrum": {
            "cumulant": f"{_HERE}.spectrum.cumulant:CumulantSpectrum",
            "gls": f"{_HERE}.spectrum.gls:GlsSpectrum",
            "covariance": f"{_HERE}.spectrum.covariance:CovarianceSpectrum",
        },
        "transform": {
            "linearised": f"{_HERE}.transform.linearised:Linearised",
            "unscented": f"{_HERE}.transform.unscented:Unscented",
            "cubature": f"{_HERE}.transform.cubature:Cubature",
        },
        "birth": {
            "fixed": f"{_HERE}.birth.fixed:Fixed",
            "given": f"{_HERE}.birth.given:Given",
            "room": f"{_HERE}.birth.room:Room",
            "from-detections": f"{_HERE}.birth.from_detections:FromDetections",
            "from-positions": f"{_HERE}.birth.from_positions:FromPositions",
            "from-spectrum": f"{_HERE}.birth.from_spectrum:FromSpectrum",
            "from-directions": f"{_HERE}.birth.from_directions:FromDirections",
        },
        "spawn": {"offset": f"{_HERE}.spawn.offset:Offset"},
        "tracker": {
            "gm-phd": f"{_HERE}.tracker.gm_phd:GaussianMixturePhd",
            "smc-phd": f"{_HERE}.tracker.smc_phd:ParticlePhd",
            "lmb": f"{_HERE}.tracker.lmb:LabelledMultiBernoulli",
            "delta-glmb": f"{_HERE}.tracker.delta_glmb:DeltaGlmb",
            "cbmember": f"{_HERE}.tracker.cbmember:CbMember",
            "gm-cbmember": f"{_HERE}.tracker.gm_cbmember:GaussianCbMember",
            "particle-filter": f"{_HERE}.tracker.particle_filter:ParticleFilter",
            "tbd": f"{_HERE}.tracker.tbd:TrackBeforeDetect",
            "field-lmb": f"{_HERE}.tracker.field_lmb:FieldLmb",
            "gaussian-filter": f"{_HERE}.tracker.gaussian_filter:GaussianFilter",
            "best-detection": f"{_HERE}.tracker.best_detection:BestDetection",
            "nobody": f"{_HERE}.tracker.nobody:Nobody",
            "room-centre": f"{_HERE}.tracker.room_centre:RoomCentre",
            "ek-phd": _gaussian_phd("linearised"),
            "uk-phd": _gaussian_phd("unscented"),
            "ck-phd": _gaussian_phd("cubature"),
        },
        "metric": {
            "ospa": f"{_HERE}.metric.ospa:Ospa",
            "gospa": f"{_HERE}.metric.gospa:Gospa",
            "cardinality": f"{_HERE}.metric.cardinality:Cardinality",
            "position-error": f"{_HERE}.metric.position_error:PositionError",
            "run-error": f"{_HERE}.metric.run_error:RunError",
            "ospa2": f"{_HERE}.metric.ospa2:Ospa2",
            "label-switches": f"{_HERE}.metric.label_switches:LabelSwitches",
            "fragmentation": f"{_HERE}.metric.fragmentation:Fragmentation",
            "t-gospa": f"{_HERE}.metric.t_gospa:TGospa",
            "clear-mot": f"{_HERE}.metric.clear_mot:ClearMot",
            "hota": f"{_HERE}.metric.hota:Hota",
            "delay-error": f"{_HERE}.metric.delay_error:DelayError",
            "direction-error": f"{_HERE}.metric.direction_error:DirectionError",
            "direction-bound": f"{_HERE}.metric.direction_bound:DirectionBound",
            "direction-posterior-bound": f"{_HERE}.metric.direction_posterior_bound:DirectionPosteriorBound",
            "bearing-posterior-bound": f"{_HERE}.metric.bearing_posterior_bound:BearingPosteriorBound",
            "ospa-direction": f"{_HERE}.metric.ospa_direction:OspaDirection",
        },
        "sound": {
            "clip": f"{_HERE}.sound.clip:Clip",
            "white": f"{_HERE}.sound.noise:White",
            "uniform": {"use": "white", "distribution": "uniform"},
            "laplace": {"use": "white", "distribution": "laplace"},
            "narrow-band": f"{_HERE}.sound.noise:NarrowBand",
            "pink": f"{_HERE}.sound.noise:Pink",
            "multitone": f"{_HERE}.sound.tones:Multitone",
            "harmonic": f"{_HERE}.sound.tones:Harmonic",
            "speech-noise": f"{_HERE}.sound.speech_noise:SpeechNoise",
        },
        "trajectory": {
            "still": f"{_HERE}.trajectory.still:Still",
            "line": f"{_HERE}.trajectory.line:Line",
            "arc": f"{_HERE}.trajectory.arc:Arc",
            "bearing": f"{_HERE}.trajectory.bearing:Bearing",
            "waypoints": f"{_HERE}.trajectory.waypoints:Waypoints",
            "wander": f"{_HERE}.trajectory.wander:Wander",
            "langevin-walk": f"{_HERE}.trajectory.langevin_walk:LangevinWalk",
            "random-walk": f"{_HERE}.trajectory.random_walk:RandomWalk",
        },
        "simulator": {
            "image-method": f"{_HERE}.simulator.image_method:ImageMethod",
            "measurements": f"{_HERE}.simulator.measurements:Measurements",
            "avs-snapshots": f"{_HERE}.simulator.avs_snapshots:AvsSnapshots",
            "pyroomacoustics": f"{_HERE}.simulator.pyroomacoustics_rooms:PyroomacousticsRooms",
        },
        "pipeline": {"pipeline": "sonobench.pipeline:Pipeline"},
    }


@hookimpl
def sonobench_data() -> str:
    return "sonobench_datasets"
