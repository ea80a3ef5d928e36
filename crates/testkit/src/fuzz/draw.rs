//! Messages with arbitrary content, from a list of arbitrary words: proptest's, which it can shrink, or a random generator's.

use plumbline_franka::wire::*;

pub const WORDS: usize = 420;

/// Draws from a list of words, over and over.
pub struct Draws<'a> {
    words: &'a [u64],
    at: usize,
    /// Real numbers fit into single precision.
    single: bool,
}

impl<'a> Draws<'a> {
    pub fn new(words: &'a [u64]) -> Draws<'a> {
        Draws { words, at: 0, single: false }
    }

    fn word(&mut self) -> u64 {
        let word = self.words[self.at % self.words.len()];
        self.at += 1;
        word
    }

    fn of<T: Copy>(&mut self, list: &[T]) -> T {
        list[(self.word() % list.len() as u64) as usize]
    }

    fn flag(&mut self) -> bool {
        self.word() % 2 == 1
    }

    fn flags<const N: usize>(&mut self) -> [bool; N] {
        std::array::from_fn(|_| self.flag())
    }

    /// Any finite number: all signs and sizes, also subnormal.
    fn real(&mut self) -> f64 {
        let word = self.word();
        let single = f64::from(f32::from_bits(word as u32));
        let number = if self.single { single } else { f64::from_bits(word) };
        if number.is_finite() { number } else { (word >> 40) as f64 }
    }

    fn reals<const N: usize>(&mut self) -> [f64; N] {
        std::array::from_fn(|_| self.real())
    }

    fn errors(&mut self) -> Errors {
        Errors::from_bits(self.word() & self.word() & ((1 << ERROR_BITS) - 1)).unwrap()
    }

    pub fn protocol(&mut self) -> Protocol {
        self.of(&Protocol::ALL)
    }

    pub fn kind(&mut self, protocol: Protocol) -> CommandKind {
        loop {
            let kind = self.of(&CommandKind::ALL);
            if kind.number(protocol).is_some() {
                return kind;
            }
            // The list of words may be a single one, over and over.
            if self.at > 2 * self.words.len() {
                return CommandKind::Connect;
            }
        }
    }

    pub fn id(&mut self) -> u32 {
        self.word() as u32
    }

    /// A state that survives the wire of `protocol` unchanged.
    pub fn state(&mut self, protocol: Protocol) -> RobotState {
        self.single = protocol == Protocol::V10;
        let mut state = RobotState {
            message_id: self.word(),
            o_t_ee: self.reals(),
            o_t_ee_d: self.reals(),
            f_t_ee: self.reals(),
            ee_t_k: self.reals(),
            f_t_ne: self.reals(),
            ne_t_ee: self.reals(),
            m_ee: self.real(),
            i_ee: self.reals(),
            f_x_cee: self.reals(),
            m_load: self.real(),
            i_load: self.reals(),
            f_x_cload: self.reals(),
            elbow: self.reals(),
            elbow_d: self.reals(),
            tau_j: self.reals(),
            tau_j_d: self.reals(),
            dtau_j: self.reals(),
            q: self.reals(),
            q_d: self.reals(),
            dq: self.reals(),
            dq_d: self.reals(),
            ddq_d: self.reals(),
            joint_contact: self.reals(),
            cartesian_contact: self.reals(),
            joint_collision: self.reals(),
            cartesian_collision: self.reals(),
            tau_ext_hat_filtered: self.reals(),
            o_f_ext_hat_k: self.reals(),
            k_f_ext_hat_k: self.reals(),
            o_dp_ee_d: self.reals(),
            o_ddp_o: self.reals(),
            elbow_c: self.reals(),
            delbow_c: self.reals(),
            ddelbow_c: self.reals(),
            o_t_ee_c: self.reals(),
            o_dp_ee_c: self.reals(),
            o_ddp_ee_c: self.reals(),
            theta: self.reals(),
            dtheta: self.reals(),
            accelerometer_top: [[0.0; 3]; 6],
            accelerometer_bottom: [[0.0; 3]; 6],
            motion_generator_mode: self.of(MotionGeneratorMode::ALL).shown_at(protocol),
            controller_mode: self.of(ControllerMode::ALL),
            errors: self.errors(),
            reflex_reason: self.errors(),
            robot_mode: self.of(RobotMode::ALL),
            control_command_success_rate: self.real(),
        };
        if protocol == Protocol::V10 {
            state.accelerometer_top = std::array::from_fn(|_| self.reals());
            state.accelerometer_bottom = std::array::from_fn(|_| self.reals());
        }
        self.single = false;
        state
    }

    /// A command that survives the wire of `protocol` unchanged.
    pub fn command(&mut self, protocol: Protocol) -> RobotCommand {
        RobotCommand {
            message_id: self.word(),
            q_c: self.reals(),
            dq_c: self.reals(),
            o_t_ee_c: self.reals(),
            o_dp_ee_c: self.reals(),
            elbow_c: self.reals(),
            valid_elbow: self.flag(),
            motion_generation_finished: self.flag(),
            tau_j_d: self.reals(),
            torque_command_finished: protocol != Protocol::V5 && self.flag(),
        }
    }

    fn deviation(&mut self) -> Deviation {
        Deviation { translation: self.real(), rotation: self.real(), elbow: self.real() }
    }

    fn motion(&mut self, protocol: Protocol) -> Move {
        let generator = match self.of(MoveGenerator::ALL) {
            MoveGenerator::None => MoveGenerator::torque_only(protocol),
            other => other,
        };
        Move {
            controller: self.of(MoveController::ALL),
            generator,
            max_path_deviation: self.deviation(),
            max_goal_pose_deviation: self.deviation(),
            use_async: protocol == Protocol::V10 && self.flag(),
            max_velocity: if protocol == Protocol::V10 { self.reals() } else { [0.0; 7] },
        }
    }

    /// A request that survives the wire of `protocol` unchanged.
    pub fn request(&mut self, protocol: Protocol, kind: CommandKind) -> Request {
        match kind {
            CommandKind::Connect => {
                Request::Connect(Connect { version: self.word() as u16, udp_port: self.word() as u16 })
            }
            CommandKind::Move => Request::Move(self.motion(protocol)),
            CommandKind::StopMove => Request::StopMove,
            CommandKind::GetCartesianLimit => Request::GetCartesianLimit(self.word() as i32),
            CommandKind::SetCollisionBehavior => Request::SetCollisionBehavior(CollisionBehavior {
                lower_torque_acceleration: self.reals(),
                upper_torque_acceleration: self.reals(),
                lower_torque_nominal: self.reals(),
                upper_torque_nominal: self.reals(),
                lower_force_acceleration: self.reals(),
                upper_force_acceleration: self.reals(),
                lower_force_nominal: self.reals(),
                upper_force_nominal: self.reals(),
            }),
            CommandKind::SetJointImpedance => Request::SetJointImpedance(self.reals()),
            CommandKind::SetCartesianImpedance => Request::SetCartesianImpedance(self.reals()),
            CommandKind::SetGuidingMode => {
                Request::SetGuidingMode(GuidingMode { axes: self.flags(), nullspace: self.flag() })
            }
            CommandKind::SetEeToK => Request::SetEeToK(self.reals()),
            CommandKind::SetNeToEe => Request::SetNeToEe(self.reals()),
            CommandKind::SetLoad => {
                Request::SetLoad(Load { mass: self.real(), com: self.reals(), inertia: self.reals() })
            }
            CommandKind::SetFilters => Request::SetFilters(Filters {
                joint_position: self.real(),
                joint_velocity: self.real(),
                cartesian_position: self.real(),
                cartesian_velocity: self.real(),
                controller: self.real(),
            }),
            CommandKind::AutomaticErrorRecovery => Request::AutomaticErrorRecovery,
            CommandKind::LoadModelLibrary => Request::LoadModelLibrary(LibraryTarget {
                architecture: self.of(Architecture::ALL),
                system: self.of(System::ALL),
            }),
            CommandKind::GetRobotModel => Request::GetRobotModel,
        }
    }

    /// A response that survives the wire of `protocol` unchanged; a library and a description are part of `text`.
    pub fn response<'t>(&mut self, protocol: Protocol, kind: CommandKind, text: &'t str) -> Response<'t> {
        macro_rules! status {
            ($status:ident) => {{
                let known = |status: &$status| status.code(protocol).is_some();
                self.of(&$status::ALL.iter().copied().filter(known).collect::<Vec<_>>())
            }};
        }
        let text = text.get(..(self.word() % (text.len() as u64 + 1)) as usize).unwrap_or(text);
        match kind {
            CommandKind::Connect => {
                Response::Connect(Connected { status: status!(ConnectStatus), version: self.word() as u16 })
            }
            CommandKind::Move => Response::Move(status!(MoveStatus)),
            CommandKind::StopMove => Response::StopMove(status!(StopStatus)),
            CommandKind::GetCartesianLimit => Response::GetCartesianLimit(CartesianLimit {
                status: status!(SetterStatus),
                size: self.reals(),
                frame: self.reals(),
                active: self.flag(),
            }),
            CommandKind::AutomaticErrorRecovery => Response::AutomaticErrorRecovery(status!(RecoveryStatus)),
            CommandKind::LoadModelLibrary => {
                Response::LoadModelLibrary { status: status!(LoadModelStatus), library: text.as_bytes() }
            }
            CommandKind::GetRobotModel => Response::GetRobotModel { status: status!(RobotModelStatus), urdf: text },
            setter => Response::Setter(setter, status!(SetterStatus)),
        }
    }
}
