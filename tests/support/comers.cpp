/// Runs sites that only publish hands: palpate_comers DOMAIN SECONDS [FIRST COUNT]. Without FIRST
/// and COUNT, seven sites join and leave every 10 ms. With them, COUNT sites stay. Their
/// names are Z and a number, from FIRST on. If the machine paused the program so long that its
/// sites could count as silent, the program reports this on stderr.
#include <chrono>
#include <cstdlib>
#include <dds/dds.h>
#include <iostream>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "site_topics.h"

int main(int argc, char** argv) {
  if (argc != 3 && argc != 5) return 2;
  const bool stay = argc == 5;
  const int first = stay ? std::atoi(argv[3]) : 0;
  const auto domain = static_cast<dds_domainid_t>(std::atoi(argv[1]));
  const auto seconds = std::chrono::duration<double>(std::atof(argv[2]));
  const dds_entity_t whole = dds_create_domain(
      domain,
      "<CycloneDDS><Domain Id=\"any\"><General><Interfaces><NetworkInterface "
      "address=\"127.0.0.1\"/>"
      "</Interfaces><AllowMulticast>false</AllowMulticast></General><Discovery><ParticipantIndex>"
      "auto</ParticipantIndex><MaxAutoParticipantIndex>14</MaxAutoParticipantIndex><Peers><Peer "
      "address=\"127.0.0.1\"/></Peers></Discovery></Domain></CycloneDDS>");
  const dds_entity_t participant = dds_create_participant(domain, nullptr, nullptr);
  const dds_entity_t topic =
      dds_create_topic(participant, &palpate_site_Hand_desc, "palpate_hand", nullptr, nullptr);
  dds_qos_t* qos = dds_create_qos();
  dds_qset_reliability(qos, DDS_RELIABILITY_BEST_EFFORT, 0);
  dds_qset_history(qos, DDS_HISTORY_KEEP_LAST, 1);
  dds_qset_liveliness(qos, DDS_LIVELINESS_AUTOMATIC, DDS_SECS(2));
  const dds_entity_t writer = dds_create_writer(participant, topic, qos, nullptr);
  dds_delete_qos(qos);
  if (writer < 0) return 1;
  std::vector<palpate_site_Hand> hands(static_cast<std::size_t>(stay ? std::atoi(argv[4]) : 7));
  const auto end = std::chrono::steady_clock::now() + seconds;
  auto last = std::chrono::steady_clock::now();
  bool late = false;
  while (last < end) {
    for (std::size_t i = 0; i < hands.size(); ++i) {
      ("Z" + std::to_string(first + static_cast<int>(i)))
          .copy(hands[i].site, sizeof hands[i].site - 1);
      ++hands[i].number;
      (void)dds_write(writer, &hands[i]);
    }
    std::this_thread::sleep_for(std::chrono::milliseconds(5));
    if (!stay) {
      for (palpate_site_Hand& hand : hands) (void)dds_dispose(writer, &hand);
      std::this_thread::sleep_for(std::chrono::milliseconds(5));
    }
    const auto before = std::exchange(last, std::chrono::steady_clock::now());
    late = late || last - before > std::chrono::milliseconds(100);
  }
  if (late) std::cerr << "the loop was late\n";
  dds_delete(whole);
}
