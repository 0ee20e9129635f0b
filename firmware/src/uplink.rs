//! The uplink: finds the host, sends what the link has to say over UDP, and hands back what the host answers.
//!
//! In live mode the radio stays up. In burst mode it is down until a batch has come together; then it comes up until
//! the store is empty or the host stays silent, and a host that stays silent is tried less and less often.

use core::net::Ipv4Addr;

use embassy_futures::select::{Either3, select3};
use embassy_net::dns::DnsQueryType;
use embassy_net::udp::{PacketMetadata, UdpSocket};
use embassy_net::{IpAddress, IpEndpoint, Stack};
use embassy_time::{Duration, Instant, Timer, with_timeout};
use thermokin_protocol::update::{UpdateOrder, UpdateRefusal, UpdateReport, UpdateState};
use thermokin_protocol::{Configuration, MAX_DATAGRAM, PowerMode};

use crate::board::{Radio, Shared};
use crate::log::{alarm, info};
use crate::update::Step;

/// Datagrams that wait in the socket, each way.
const QUEUE: usize = 2;
/// The longest wait between two rounds of the loop: the vigil wants to see it come round.
const ROUND: Duration = Duration::from_secs(1);
/// The longest that a burst waits for the network to come up.
const JOINING: Duration = Duration::from_secs(15);
/// The longest that a burst waits for the host to answer.
const SILENCE: Duration = Duration::from_secs(3);
/// A host that was not heard for this long is looked up again: it may have another address by now.
const LOOK_AGAIN: Duration = Duration::from_secs(60);
/// The first wait after a look-up that failed; it doubles.
const FIRST_RETRY: Duration = Duration::from_secs(1);
/// The wait after a look-up that failed doubles up to here.
const LAST_RETRY: Duration = Duration::from_secs(60);
/// The time that the last words before a restart are given to leave.
const FAREWELL: Duration = Duration::from_millis(500);
/// Bursts that found no host are followed by up to 2^4 times as many records.
const MAX_DOUBLINGS: u32 = 4;

/// Sends the link's datagrams to the host and takes its answers.
pub(crate) struct Uplink<'a, R> {
    stack: Stack<'a>,
    radio: R,
    configuration: &'a Configuration,
    /// The wait after the next look-up that fails.
    retry: Duration,
    /// No look-up before this.
    next_look_up: Instant,
    /// When a transfer of a new program last went on; a burst waits for it.
    transferred: Option<Instant>,
}

/// How a burst ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Burst {
    /// The host has everything.
    Done,
    /// The network did not come up, or the host did not answer.
    Alone,
}

impl<'a, R: Radio> Uplink<'a, R> {
    /// An uplink over a network to the host that the configuration names.
    pub(crate) fn new(stack: Stack<'a>, radio: R, configuration: &'a Configuration) -> Self {
        Self {
            stack,
            radio,
            configuration,
            retry: FIRST_RETRY,
            next_look_up: Instant::from_ticks(0),
            transferred: None,
        }
    }

    /// Runs for ever.
    pub(crate) async fn run<const BLOCKS: usize>(&mut self, shared: &Shared<'_, BLOCKS>) {
        let (mut receive_metadata, mut send_metadata) =
            ([PacketMetadata::EMPTY; QUEUE], [PacketMetadata::EMPTY; QUEUE]);
        let (mut receive_buffer, mut send_buffer) = ([0; QUEUE * MAX_DATAGRAM], [0; QUEUE * MAX_DATAGRAM]);
        let mut socket = UdpSocket::new(
            self.stack,
            &mut receive_metadata,
            &mut receive_buffer,
            &mut send_metadata,
            &mut send_buffer,
        );
        // Port 0 lets the stack choose; a socket that was just made is not bound yet, so this cannot fail.
        if socket.bind(0).is_err() {
            return;
        }
        let mut host = None;
        loop {
            let mode = shared.link.borrow().settings().power;
            match mode {
                PowerMode::Live => {
                    self.switch_on(shared).await;
                    self.live(shared, &socket, &mut host).await;
                }
                PowerMode::Burst => {
                    self.switch_off(shared).await;
                    self.bursts(shared, &socket, &mut host).await;
                }
            }
        }
    }

    async fn switch_on<const BLOCKS: usize>(&mut self, shared: &Shared<'_, BLOCKS>) {
        self.radio.up().await;
        shared.duty.borrow_mut().radio_switched_on(Instant::now());
    }

    async fn switch_off<const BLOCKS: usize>(&mut self, shared: &Shared<'_, BLOCKS>) {
        self.radio.down().await;
        shared.duty.borrow_mut().radio_switched_off(Instant::now());
    }

    /// Until the host asks for another mode.
    async fn live<const BLOCKS: usize>(
        &mut self,
        shared: &Shared<'_, BLOCKS>,
        socket: &UdpSocket<'_>,
        host: &mut Option<Host>,
    ) {
        while shared.link.borrow().settings().power == PowerMode::Live {
            self.round(shared, socket, host).await;
        }
    }

    /// Until the host asks for another mode. The radio is down when this begins and when it ends.
    async fn bursts<const BLOCKS: usize>(
        &mut self,
        shared: &Shared<'_, BLOCKS>,
        socket: &UdpSocket<'_>,
        host: &mut Option<Host>,
    ) {
        let mut doublings = 0;
        let mut sent_until = 0;
        while shared.link.borrow().settings().power == PowerMode::Burst {
            shared.vigil.uplink_came_round(Instant::now());
            let (due, next) = {
                let link = shared.link.borrow();
                let batch = u64::from(link.settings().batch_length.max(1)) << doublings;
                (link.outbox().next_sequence() >= sent_until + batch, link.outbox().next_sequence())
            };
            if !due {
                // The timer only shows the vigil that this still runs.
                let _ = with_timeout(ROUND, shared.recorded.wait()).await;
                continue;
            }
            sent_until = next;
            self.switch_on(shared).await;
            doublings = match self.burst(shared, socket, host).await {
                Burst::Done => 0,
                Burst::Alone => (doublings + 1).min(MAX_DOUBLINGS),
            };
            self.switch_off(shared).await;
        }
    }

    /// The radio is up: sends until the host has everything, or is silent.
    async fn burst<const BLOCKS: usize>(
        &mut self,
        shared: &Shared<'_, BLOCKS>,
        socket: &UdpSocket<'_>,
        host: &mut Option<Host>,
    ) -> Burst {
        let joining = Instant::now();
        while !self.stack.is_config_up() {
            shared.vigil.uplink_came_round(Instant::now());
            if joining.elapsed() > JOINING {
                alarm!("the network did not come up");
                return Burst::Alone;
            }
            let _ = with_timeout(ROUND, self.stack.wait_config_up()).await;
        }
        let mut progress = Instant::now();
        while progress.elapsed() < SILENCE {
            let before = shared.link.borrow().heard_us();
            self.round(shared, socket, host).await;
            let link = shared.link.borrow();
            if link.heard_us() != before {
                progress = Instant::now();
                let transferring = self.transferred.is_some_and(|last| last.elapsed() < SILENCE);
                if link.outbox().is_empty() && !transferring {
                    return Burst::Done;
                }
            }
        }
        Burst::Alone
    }

    /// One round: sends what is due, then waits for an answer, a record or the next time that something is due.
    async fn round<const BLOCKS: usize>(
        &mut self,
        shared: &Shared<'_, BLOCKS>,
        socket: &UdpSocket<'_>,
        host: &mut Option<Host>,
    ) {
        shared.vigil.uplink_came_round(Instant::now());
        let Some(endpoint) = self.find(shared, host).await else {
            return;
        };
        let mut datagram = [0; MAX_DATAGRAM];
        let checking = self.check(shared, socket, endpoint, &mut datagram).await;
        loop {
            let now = Instant::now();
            let length = {
                let mut link = shared.link.borrow_mut();
                link.set_health(shared.battery.get(), self.radio.signal(), shared.counters.get());
                link.poll(now.as_micros(), &mut datagram)
            };
            let Some(length) = length else { break };
            match with_timeout(ROUND, socket.send_to(&datagram[..length], endpoint)).await {
                Ok(Ok(())) => shared.duty.borrow_mut().sent(length),
                Ok(Err(_)) | Err(_) => {
                    // The link sends its records again; what matters is not to spin meanwhile.
                    alarm!("a datagram of {=usize} bytes could not be sent", length);
                    Timer::after(ROUND).await;
                    return;
                }
            }
        }
        let now = Instant::now();
        let due = Instant::from_micros(shared.link.borrow().next_poll_us(now.as_micros()));
        let longest = if checking { Duration::from_millis(1) } else { ROUND };
        let due = due.clamp(now + Duration::from_millis(1), now + longest);
        match select3(socket.recv_from(&mut datagram), shared.recorded.wait(), Timer::at(due)).await {
            Either3::First(Ok((length, _))) => {
                if let Some(report) = self.heard(shared, &mut datagram[..length]) {
                    self.report(shared, socket, endpoint, report, &mut datagram).await;
                }
            }
            // A datagram longer than the protocol's is nobody's of ours.
            Either3::First(Err(_)) | Either3::Second(()) | Either3::Third(()) => {}
        }
    }

    /// Takes a datagram; gives what to report of a new program if that is what it was about.
    fn heard<const BLOCKS: usize>(&mut self, shared: &Shared<'_, BLOCKS>, datagram: &mut [u8]) -> Option<UpdateReport> {
        let now = Instant::now();
        let heard = match shared.link.borrow_mut().receive(now.as_micros(), datagram) {
            Ok(heard) => heard,
            Err(_refused) => {
                #[cfg(feature = "defmt")]
                defmt::warn!("a datagram was refused: {}", _refused);
                return None;
            }
        };
        if heard.settings_changed {
            info!("new settings from the host");
        }
        let mut updates = shared.updates.borrow_mut();
        if heard.released > 0
            && let Some(updates) = updates.as_mut()
        {
            updates.acknowledged();
        }
        let order = heard.update?;
        let report = updates.as_mut().map_or_else(|| no_slots(&order), |updates| updates.order(&order));
        if !report.state.is_final() {
            self.transferred = Some(now);
        }
        Some(report)
    }

    /// Goes on with checking a new program, and restarts into it when that is done; whether there is more to check.
    async fn check<const BLOCKS: usize>(
        &mut self,
        shared: &Shared<'_, BLOCKS>,
        socket: &UdpSocket<'_>,
        endpoint: IpEndpoint,
        datagram: &mut [u8; MAX_DATAGRAM],
    ) -> bool {
        let step = shared.updates.borrow_mut().as_mut().map_or(Step::Idle, |updates| updates.step());
        match step {
            Step::Idle => false,
            Step::More => {
                self.transferred = Some(Instant::now());
                true
            }
            Step::Report(report) => {
                self.report(shared, socket, endpoint, report, datagram).await;
                if report.state == UpdateState::Restarting {
                    Timer::after(FAREWELL).await;
                    (shared.restart)();
                }
                false
            }
        }
    }

    /// Tells the host how far a new program is. What is lost is asked for again.
    async fn report<const BLOCKS: usize>(
        &mut self,
        shared: &Shared<'_, BLOCKS>,
        socket: &UdpSocket<'_>,
        endpoint: IpEndpoint,
        report: UpdateReport,
        datagram: &mut [u8; MAX_DATAGRAM],
    ) {
        let length = shared.link.borrow_mut().seal_update(&report, datagram);
        if let Some(length) = length
            && let Ok(Ok(())) = with_timeout(ROUND, socket.send_to(&datagram[..length], endpoint)).await
        {
            shared.duty.borrow_mut().sent(length);
        }
    }

    /// Where the host is, looked up when that is not known or when it was not heard for long. Without an answer it takes
    /// a moment, so that its caller does not spin.
    async fn find<const BLOCKS: usize>(
        &mut self,
        shared: &Shared<'_, BLOCKS>,
        host: &mut Option<Host>,
    ) -> Option<IpEndpoint> {
        if !self.stack.is_config_up() {
            let _ = with_timeout(ROUND, self.stack.wait_config_up()).await;
            return None;
        }
        let now = Instant::now();
        let heard = shared.link.borrow().heard_us().map_or(Instant::from_ticks(0), Instant::from_micros);
        let fresh = |host: &Host| now.saturating_duration_since(heard.max(host.found)) < LOOK_AGAIN;
        // While it cannot be looked up, the old address is still the best guess.
        if let Some(host) = host.as_ref().filter(|host| host.fixed || fresh(host) || now < self.next_look_up) {
            return Some(host.endpoint);
        }
        if now < self.next_look_up {
            Timer::at(self.next_look_up.min(now + ROUND)).await;
            return None;
        }
        let name = self.configuration.host.as_str();
        let fixed = name.parse::<Ipv4Addr>().ok();
        let address = match fixed {
            Some(address) => Some(IpAddress::Ipv4(address)),
            // The stack asks by multicast for names that end in .local, and the network's name server for others.
            None => match with_timeout(ROUND * 5, self.stack.dns_query(name, DnsQueryType::A)).await {
                Ok(Ok(addresses)) => addresses.first().copied(),
                Ok(Err(_)) | Err(_) => None,
            },
        };
        let Some(address) = address else {
            alarm!("the host was not found by its name");
            self.next_look_up = Instant::now() + self.retry;
            self.retry = (self.retry * 2).min(LAST_RETRY);
            return host.as_ref().map(|host| host.endpoint);
        };
        info!("host found");
        self.retry = FIRST_RETRY;
        let endpoint = IpEndpoint::new(address, self.configuration.port);
        *host = Some(Host { endpoint, found: now, fixed: fixed.is_some() });
        Some(endpoint)
    }
}

/// What a board without a second slot says to an offer.
fn no_slots(order: &UpdateOrder<'_>) -> UpdateReport {
    let order = match order {
        UpdateOrder::Offer(offer) => offer.order,
        UpdateOrder::Chunk(chunk) => chunk.order,
    };
    UpdateReport { order, state: UpdateState::Refused(UpdateRefusal::NoSlots) }
}

/// A host that was found.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Host {
    endpoint: IpEndpoint,
    /// When it was looked up.
    found: Instant,
    /// Whether it was configured as an address, which never changes.
    fixed: bool,
}
