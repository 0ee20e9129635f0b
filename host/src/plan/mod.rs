//! What is worth measuring: poses that identify an arm best, the fewest temperature sensors, when to warm the arm up and
//! cool it down, and how to warm one joint at a time.
//!
//! | module | owns |
//! | --- | --- |
//! | `telling` | what a pose would tell: whitened rows, from the same derivatives as a calibration |
//! | `space` | where poses may be: joint limits, working volume, and what the tracker sees |
//! | `index` | what "best" means, and what a pose more or less does to it |
//! | `exchange` | the search: excursions that add and remove poses, then moves of single poses |
//! | `poses` | a plan of poses, what more would buy, and how other sets of poses compare |
//! | `sensors` | the smallest set of temperature sensors |
//! | `schedule` | warm-up and cool-down, and probes of single joints, tried on the twin |

mod exchange;
mod index;
mod poses;
mod schedule;
mod sensors;
mod space;
mod telling;

pub use exchange::{Exchange, Search, exchange};
pub use index::{Criterion, Index, Information};
pub use poses::{PlanError, Planned, Planner, Spread, Worth, in_order};
pub use schedule::{ScheduleError, TriedSchedule, prepared, probes, schedule_of, tell_apart};
pub use sensors::{SensorError, SensorPlan, SensorSet, SensorStudy};
pub use space::{Refused, Space, SpaceError, Visibility};
pub use telling::{Setup, Telling};
