//! Every field of a state and of a command against its offset and size in the C++ headers, as `offsetof` and `sizeof` print them.

use plumbline_franka::wire::layout::Slot;
use plumbline_franka::wire::*;

/// Name, offset and size at versions 5 and 9, the same at version 10, and what is read from there.
type Row<T> = (&'static str, usize, usize, usize, usize, fn(&T) -> Vec<f64>);

/// Where a version has no such field.
const NONE: usize = usize::MAX;

#[rustfmt::skip]
const STATE: &[Row<RobotState>] = &[
    ("O_T_EE", 8, 128, 8, 64, |s| s.o_t_ee.to_vec()),
    ("O_T_EE_d", 136, 128, 72, 64, |s| s.o_t_ee_d.to_vec()),
    ("F_T_EE", 264, 128, 136, 64, |s| s.f_t_ee.to_vec()),
    ("EE_T_K", 392, 128, 200, 64, |s| s.ee_t_k.to_vec()),
    ("F_T_NE", 520, 128, 264, 64, |s| s.f_t_ne.to_vec()),
    ("NE_T_EE", 648, 128, 328, 64, |s| s.ne_t_ee.to_vec()),
    ("m_ee", 776, 8, 392, 4, |s| vec![s.m_ee]),
    ("I_ee", 784, 72, 396, 36, |s| s.i_ee.to_vec()),
    ("F_x_Cee", 856, 24, 432, 12, |s| s.f_x_cee.to_vec()),
    ("m_load", 880, 8, 444, 4, |s| vec![s.m_load]),
    ("I_load", 888, 72, 448, 36, |s| s.i_load.to_vec()),
    ("F_x_Cload", 960, 24, 484, 12, |s| s.f_x_cload.to_vec()),
    ("elbow", 984, 16, 496, 8, |s| s.elbow.to_vec()),
    ("elbow_d", 1000, 16, 504, 8, |s| s.elbow_d.to_vec()),
    ("tau_J", 1016, 56, 512, 28, |s| s.tau_j.to_vec()),
    ("tau_J_d", 1072, 56, 540, 28, |s| s.tau_j_d.to_vec()),
    ("dtau_J", 1128, 56, 568, 28, |s| s.dtau_j.to_vec()),
    ("q", 1184, 56, 596, 28, |s| s.q.to_vec()),
    ("q_d", 1240, 56, 624, 28, |s| s.q_d.to_vec()),
    ("dq", 1296, 56, 652, 28, |s| s.dq.to_vec()),
    ("dq_d", 1352, 56, 680, 28, |s| s.dq_d.to_vec()),
    ("ddq_d", 1408, 56, 708, 28, |s| s.ddq_d.to_vec()),
    ("joint_contact", 1464, 56, 736, 28, |s| s.joint_contact.to_vec()),
    ("cartesian_contact", 1520, 48, 764, 24, |s| s.cartesian_contact.to_vec()),
    ("joint_collision", 1568, 56, 788, 28, |s| s.joint_collision.to_vec()),
    ("cartesian_collision", 1624, 48, 816, 24, |s| s.cartesian_collision.to_vec()),
    ("tau_ext_hat_filtered", 1672, 56, 840, 28, |s| s.tau_ext_hat_filtered.to_vec()),
    ("O_F_ext_hat_K", 1728, 48, 868, 24, |s| s.o_f_ext_hat_k.to_vec()),
    ("K_F_ext_hat_K", 1776, 48, 892, 24, |s| s.k_f_ext_hat_k.to_vec()),
    ("O_dP_EE_d", 1824, 48, 916, 24, |s| s.o_dp_ee_d.to_vec()),
    ("O_ddP_O", 1872, 24, 940, 12, |s| s.o_ddp_o.to_vec()),
    ("elbow_c", 1896, 16, 952, 8, |s| s.elbow_c.to_vec()),
    ("delbow_c", 1912, 16, 960, 8, |s| s.delbow_c.to_vec()),
    ("ddelbow_c", 1928, 16, 968, 8, |s| s.ddelbow_c.to_vec()),
    ("O_T_EE_c", 1944, 128, 976, 64, |s| s.o_t_ee_c.to_vec()),
    ("O_dP_EE_c", 2072, 48, 1040, 24, |s| s.o_dp_ee_c.to_vec()),
    ("O_ddP_EE_c", 2120, 48, 1064, 24, |s| s.o_ddp_ee_c.to_vec()),
    ("theta", 2168, 56, 1088, 28, |s| s.theta.to_vec()),
    ("dtheta", 2224, 56, 1116, 28, |s| s.dtheta.to_vec()),
    ("accelerometer_top", NONE, 0, 1144, 72, |s| s.accelerometer_top.as_flattened().to_vec()),
    ("accelerometer_bottom", NONE, 0, 1216, 72, |s| s.accelerometer_bottom.as_flattened().to_vec()),
    ("control_command_success_rate", 2365, 8, 1373, 4, |s| vec![s.control_command_success_rate]),
];

/// Fields of a state that are no real numbers: name, offset and size as above.
#[rustfmt::skip]
const STATE_REST: &[(&str, usize, usize, usize, usize)] = &[
    ("message_id", 0, 8, 0, 8),
    ("motion_generator_mode", 2280, 1, 1288, 1),
    ("controller_mode", 2281, 1, 1289, 1),
    ("errors", 2282, 41, 1290, 41),
    ("reflex_reason", 2323, 41, 1331, 41),
    ("robot_mode", 2364, 1, 1372, 1),
];

/// Name, offset, size.
const COMMAND: &[(&str, usize, usize)] = &[
    ("message_id", 0, 8),
    ("q_c", 8, 56),
    ("dq_c", 64, 56),
    ("O_T_EE_c", 120, 128),
    ("O_dP_EE_c", 248, 48),
    ("elbow_c", 296, 16),
    ("valid_elbow", 312, 1),
    ("motion_generation_finished", 313, 1),
    ("tau_J_d", 314, 56),
    ("torque_command_finished", 370, 1),
];

/// Name, offset and size of every field of the table, which has to be without gaps.
fn places<T>(layout: &[Slot<T>], bytes: usize) -> Vec<(&'static str, usize, usize)> {
    let mut end = 0;
    for slot in layout {
        assert_eq!(slot.offset, end, "{}", slot.name);
        end = slot.end();
    }
    assert_eq!(end, bytes);
    layout.iter().map(|slot| (slot.name, slot.offset, slot.bytes())).collect()
}

#[test]
fn every_field_of_a_state_lies_where_the_headers_put_it() {
    for protocol in Protocol::ALL {
        let single = protocol == Protocol::V10;
        let pick = |name, a, a_bytes, b, b_bytes| if single { (name, b, b_bytes) } else { (name, a, a_bytes) };
        let reals = STATE.iter().map(|row| pick(row.0, row.1, row.2, row.3, row.4));
        let rest = STATE_REST.iter().map(|row| pick(row.0, row.1, row.2, row.3, row.4));
        let mut expected: Vec<_> = reals.chain(rest).filter(|place| place.1 != NONE).collect();
        expected.sort_by_key(|place| place.1);
        assert_eq!(places(protocol.state_layout(), if single { 1377 } else { 2373 }), expected, "{protocol}");
    }
}

#[test]
fn every_field_of_a_command_lies_where_the_headers_put_it() {
    for (protocol, fields, bytes) in [(Protocol::V5, 9, 370), (Protocol::V9, 10, 371), (Protocol::V10, 10, 371)] {
        assert_eq!(places(protocol.command_layout(), bytes), COMMAND[..fields], "{protocol}");
    }
}

#[test]
fn every_member_of_a_state_is_read_from_its_own_place() {
    for protocol in Protocol::ALL {
        let single = protocol == Protocol::V10;
        let mut packet = vec![0; if single { 1377 } else { 2373 }];
        let mut expected = Vec::new();
        for (name, a, a_bytes, b, b_bytes, get) in STATE {
            let (offset, bytes) = if single { (*b, *b_bytes) } else { (*a, *a_bytes) };
            let numbers: Vec<f64> =
                (0..bytes / if single { 4 } else { 8 }).map(|k| (offset + k) as f64 + 0.5).collect();
            for (k, number) in numbers.iter().enumerate() {
                if single {
                    packet[offset + 4 * k..][..4].copy_from_slice(&(*number as f32).to_le_bytes());
                } else {
                    packet[offset + 8 * k..][..8].copy_from_slice(&number.to_le_bytes());
                }
            }
            if !numbers.is_empty() {
                expected.push((name, get, numbers));
            }
        }
        packet[..8].copy_from_slice(&0x0102_0304_0506_0708_u64.to_le_bytes());
        let modes = if single { 1288 } else { 2280 };
        packet[modes] = 3;
        packet[modes + 1] = 1;
        packet[modes + 2 + 14] = 1;
        packet[modes + 2 + 40] = 1;
        packet[modes + 43] = 1;
        packet[modes + 43 + 25] = 1;
        packet[modes + 84] = 4;

        let state = RobotState::decode(protocol, &packet).unwrap();
        for (name, get, numbers) in expected {
            assert_eq!(get(&state), numbers, "{name} at {protocol}");
        }
        assert_eq!(state.message_id, 0x0102_0304_0506_0708);
        assert_eq!(state.motion_generator_mode, MotionGeneratorMode::CartesianPose);
        assert_eq!(state.controller_mode, ControllerMode::CartesianImpedance);
        assert_eq!(state.robot_mode, RobotMode::Reflex);
        let violation = "joint_motion_generator_velocity_discontinuity";
        assert_eq!(state.errors.to_string(), format!("{violation}, base_acceleration_invalid_reading"));
        let reasons = "joint_position_limits_violation, communication_constraints_violation";
        assert_eq!(state.reflex_reason.to_string(), reasons);
        assert_eq!(state.accelerometer_top == [[0.0; 3]; 6], !single);

        let mut again = [0; MAX_STATE];
        let length = state.encode(protocol, &mut again);
        assert_eq!(&again[..length], packet, "{protocol}");
    }
}

#[test]
fn every_member_of_a_command_is_read_from_its_own_place() {
    for protocol in Protocol::ALL {
        let mut packet = vec![0; protocol.command_bytes()];
        for (offset, count) in [(8, 7), (64, 7), (120, 16), (248, 6), (296, 2), (314, 7)] {
            for k in 0..count {
                packet[offset + 8 * k..][..8].copy_from_slice(&((offset + k) as f64).to_le_bytes());
            }
        }
        packet[..8].copy_from_slice(&77_u64.to_le_bytes());
        packet[313] = 1;
        if let Some(finished) = packet.get_mut(370) {
            *finished = 1;
        }
        let from = |offset: usize| move |k: usize| (offset + k) as f64;
        let expected = RobotCommand {
            message_id: 77,
            q_c: std::array::from_fn(from(8)),
            dq_c: std::array::from_fn(from(64)),
            o_t_ee_c: std::array::from_fn(from(120)),
            o_dp_ee_c: std::array::from_fn(from(248)),
            elbow_c: std::array::from_fn(from(296)),
            valid_elbow: false,
            motion_generation_finished: true,
            tau_j_d: std::array::from_fn(from(314)),
            torque_command_finished: protocol != Protocol::V5,
        };
        assert_eq!(RobotCommand::decode(protocol, &packet), Ok(expected));
        let mut again = [0; MAX_COMMAND];
        let length = expected.encode(protocol, &mut again);
        assert_eq!(&again[..length], packet, "{protocol}");
    }
}
