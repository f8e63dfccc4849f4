//! The links between vehicles on one machine, through conditioners where they are to be cut.

use std::net::SocketAddr;

use anyhow::Context;
use sim::{Conditioner, Cut};

/// A link, by the vehicle that listens and the one that connects.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct LinkPair {
    pub server_idx: usize,
    pub client_idx: usize,
}

/// A full mesh: each vehicle connects to all that started before it.
pub struct Links {
    can_be_cut: bool,
    addresses: Vec<SocketAddr>,
    links: Vec<(LinkPair, Option<Conditioner>)>,
}

impl Links {
    pub fn new(can_be_cut: bool) -> Self {
        Self {
            can_be_cut,
            addresses: Vec::new(),
            links: Vec::new(),
        }
    }

    /// Where the next vehicle connects to.
    pub fn endpoints_for(&mut self, client_idx: usize) -> anyhow::Result<Vec<String>> {
        let mut endpoints = Vec::new();
        for (server_idx, server) in self.addresses.iter().enumerate() {
            let conditioner = if self.can_be_cut {
                let any_port = SocketAddr::from(([127, 0, 0, 1], 0));
                let conditioner = Conditioner::start(any_port, *server);
                Some(conditioner.context("cannot listen on loopback")?)
            } else {
                None
            };
            let address = conditioner.as_ref().map_or(*server, Conditioner::address);
            endpoints.push(format!("tcp/{address}"));
            let pair = LinkPair {
                server_idx,
                client_idx,
            };
            self.links.push((pair, conditioner));
        }
        Ok(endpoints)
    }

    /// Takes note of where a vehicle listens.
    pub fn add_vehicle(&mut self, endpoints: &[String]) -> anyhow::Result<()> {
        self.addresses.push(loopback_address(endpoints)?);
        Ok(())
    }

    pub fn pairs(&self) -> Vec<LinkPair> {
        self.links.iter().map(|(pair, _)| *pair).collect()
    }

    /// Cuts or heals a link; whether that changed anything.
    pub fn set_cut(&mut self, wanted: LinkPair, cut: Option<Cut>) -> bool {
        let link = self.links.iter().find(|(pair, _)| *pair == wanted);
        let Some((_, Some(conditioner))) = link else {
            return false;
        };
        if conditioner.cut_in_force() == cut {
            return false;
        }
        match cut {
            Some(cut) => conditioner.cut(cut),
            None => conditioner.heal(),
        }
        true
    }
}

/// The address of a loopback endpoint such as `tcp/127.0.0.1:40001`.
pub fn loopback_address(endpoints: &[String]) -> anyhow::Result<SocketAddr> {
    let mut addresses = endpoints
        .iter()
        .filter_map(|endpoint| endpoint.strip_prefix("tcp/")?.parse().ok());
    addresses
        .find(|address: &SocketAddr| address.ip().is_loopback())
        .with_context(|| format!("a vehicle does not listen on loopback: {endpoints:?}"))
}
